"""``jaxdet config`` prints parameters as TOML."""

import pytest

from jaxdet.cli import main
from jaxdet.config_file import find_config
from jaxdet.presets import PRESETS, preset


@pytest.mark.parametrize("name", PRESETS)
def test_the_file_of_a_preset_loads_as_that_preset(tmp_path, capsys, name):
    path = tmp_path / "mine.toml"
    assert main(["config", name, "--output", str(path)]) == 0
    assert find_config(path) == preset(name)
    assert main(["config", str(path)]) == 0
    values = [line for line in path.read_text("utf-8").splitlines() if line[:1] not in ("#", "")]
    assert set(values[1:]) <= set(capsys.readouterr().out.splitlines())


def test_parameters_are_explained_and_existing_files_are_kept(tmp_path, capsys):
    path = tmp_path / "mine.toml"
    path.write_text("mine", "utf-8")
    assert main(["config", "-o", str(path)]) == 2
    assert "exists" in capsys.readouterr().err and path.read_text("utf-8") == "mine"
    assert main(["config", "no-such"]) == 2
    assert main(["config"]) == 0
    text = capsys.readouterr().out
    assert "# camera_height_m =" in text and "[obstacle]" in text and "\n# " in text
