import json
from pathlib import Path
from threading import Event

import pytest

from jaxdet.errors import ConfigError, InputError, OutputError
from jaxdet.fleet import list_logs, share_of
from jaxdet.fleet import place as places
from jaxdet.fleet.logs import size_of
from jaxdet.fleet.place import Bucket, Folder, address, is_url, open_place, scrub


@pytest.fixture(params=["folder", "bucket", pytest.param("s3", marks=pytest.mark.fleet)])
def place(request, tmp_path):
    if request.param == "s3":
        return open_place(request.getfixturevalue("bucket") + "/place")
    if request.param == "folder":
        return Folder(str(tmp_path / "place"))
    request.getfixturevalue("stores")
    return open_place("s3://bucket/place")


def test_files_are_created_once_and_replaced_only_if_unchanged(place):
    assert place.get("a/b") is None
    assert place.create("a/b", b"1") and not place.create("a/b", b"2")
    content, tag = place.get("a/b")
    assert content == b"1"
    assert place.swap("a/b", b"22", tag) and not place.swap("a/b", b"333", tag)
    assert place.get("a/b")[0] == b"22"
    assert not place.swap("a/c", b"1", tag)
    place.put("a/c", b"4")
    assert {(e.key, e.size) for e in place.list("a")} == {("a/b", 2), ("a/c", 1)}
    place.delete(["a/b", "a/c", "a/d"])
    assert place.get("a/b") is None
    places.probe(place)
    assert not [e for e in place.list() if "probe" in e.key]


def test_a_store_without_conditional_writes_is_refused(stores, monkeypatch):
    place = open_place("s3://bucket/place")
    put_if = Bucket._put_if
    for ignored in ("create", "swap"):

        def lenient(self, key, content, mode, ignored=ignored):
            if (mode == "create") == (ignored == "create"):
                self.put(key, content)
                return True
            return put_if(self, key, content, mode)

        monkeypatch.setattr(Bucket, "_put_if", lenient)
        with pytest.raises(ConfigError, match="ignores conditional writes"):
            places.probe(place)


SECRETS = [
    "s3://AKID:sec/ret@bucket/logs",
    "S3://AKID:secret@bucket/logs",
    "s3://secret@bucket/logs",
    "s3://bucket/logs?X-Amz-Signature=secret",
    "https://user:secret@host/logs",
    "az://account/container/logs?sig=secret",
]


@pytest.mark.parametrize("url", SECRETS)
def test_credentials_in_an_address_are_refused_and_not_shown(url, tmp_path):
    for text in (url, Path(url)):
        with pytest.raises(ConfigError) as raised:
            address(text)
        shown = f"{raised.value} {raised.value!r} {vars(raised.value)}"
        assert "secret" not in shown and "sec/ret" not in shown and "AKID" not in shown


def test_credentials_in_an_error_of_the_store_are_not_shown(stores):
    class Broken:
        def __getattr__(self, name):
            body = (
                "<Error><Code>Denied</Code>\n<Message>No access</Message><Key>secret</Key></Error>"
            )
            body = f'<?xml version="1.0"?>\n{body}\nDebug: secret'
            raise OSError(f"GET https://user:secret@host/x?sig=secret: 403 {body}")

    place = Bucket("s3://bucket/x")
    with pytest.raises(OutputError) as raised, place._reached("key"):
        Broken().read()
    assert "secret" not in str(raised.value) and "403 Denied: No access)" in str(raised.value)
    assert "s3://bucket/x/key" in str(raised.value)


def test_addresses_are_normalized(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert address(Path("s3://bucket/a/")) == "s3://bucket/a"
    assert address("gs://bucket") == "gs://bucket"
    assert address("folder") == str(tmp_path / "folder")
    assert is_url("az://account/container") and not is_url("folder/s3")
    for wrong in ("s3://", "ftp://host/x"):
        with pytest.raises(ConfigError):
            address(wrong)
    assert scrub("plain text") == "plain text"


@pytest.fixture(params=["bucket", pytest.param("s3", marks=pytest.mark.fleet)])
def logs(request, monkeypatch):
    monkeypatch.setattr(places, "RANGE_BYTES", 100)
    if request.param == "s3":
        return open_place(request.getfixturevalue("bucket") + "/logs")
    request.getfixturevalue("stores")
    return open_place("s3://bucket/logs")


@pytest.mark.parametrize("size", [0, 1, 1000, 4096])
def test_a_file_is_fetched_in_ranges(logs, tmp_path, size):
    content = bytes(i * 7 % 251 for i in range(size))
    logs.put("a.mcap", content)
    (entry,) = logs.list()
    logs.fetch(entry, tmp_path / "a", Event())
    assert (tmp_path / "a").read_bytes() == content


def test_a_file_replaced_while_it_is_fetched_is_an_error(logs, monkeypatch, tmp_path):
    monkeypatch.setattr(places, "CONNECTIONS", 1)
    place = logs
    place.put("a.mcap", bytes(1000))
    (entry,) = place.list()
    reached, seen = Bucket._range, []

    def late(self, entry, start, file, stop):
        seen.append(start)
        if len(seen) == 3:
            place.put("a.mcap", bytes(range(200)) * 5)
        reached(self, entry, start, file, stop)

    monkeypatch.setattr(Bucket, "_range", late)
    with pytest.raises(InputError, match="replaced while it was fetched"):
        place.fetch(entry, tmp_path / "a", Event())
    place.delete(["a.mcap"])
    with pytest.raises(InputError, match="replaced"):
        place.fetch(entry, tmp_path / "a", Event())


def test_logs_of_a_bucket_are_listed(stores):
    url = "s3://bucket/logs"
    place = open_place(url)
    names = ["day/a_0.mcap", "day/a_1.mcap", "b.mcap", "b.bag", "c_0.mcap", "c_1.mcap", "x.txt"]
    names += ["b.jaxdet.mcap", ".hidden/d.mcap", "gone/metadata.yaml"]
    for name in names:
        place.put(name, name.encode())
    yaml = "rosbag2_bagfile_information:\n  relative_file_paths:\n    - a_0.mcap\n    - a_1.mcap\n"
    place.put("day/metadata.yaml", yaml.encode())
    place.put("gone/metadata.yaml", yaml.encode())
    logs = {log["log"]: log for log in list_logs(url)}
    assert {name: [f["key"] for f in log["files"]] for name, log in logs.items()} == {
        "day/a": ["day/a_0.mcap", "day/a_1.mcap", "day/metadata.yaml"],
        "b": ["b.mcap"],
        "c_0": ["c_0.mcap"],
        "c_1": ["c_1.mcap"],
        ".hidden/d": [".hidden/d.mcap"],
    }
    assert json.loads(json.dumps(logs)) == logs
    assert logs["day/a"]["name"] == "day--a" and size_of(logs["b"]) == 6
    notes = filter(None, (log.get("remarks", {}).get("note") for log in logs.values()))
    assert [*notes] == ["b.bag is left out: the same recording exists as .mcap"]


LISTED = "rosbag2_bagfile_information:\n  relative_file_paths:\n"
LAYOUTS = {
    "one file": {"r/r_0.mcap": "", "r/metadata.yaml": "    - r_0.mcap\n"},
    "quotes": {
        "r/my r_0.mcap": "",
        "r/my r_1.mcap": "",
        "r/metadata.yaml": "  - 'my r_0.mcap'\n  - \"my r_1.mcap\"  # last\n",
    },
    "packed": {"a.mcap.zst": "", "a.mcap": "", "b.bag.bz2": "", "x.csv.zst": ""},
    "packed splits": {
        "r/r_0.db3.zstd": "",
        "r/r_1.db3.zstd": "",
        "r/metadata.yaml": "  - r_0.db3.zstd\n  - r_1.db3.zstd\n",
    },
    "hidden": {
        ".trash/x.mcap": "",
        "a/.old/y.bag": "",
        ".z.mcap": "",
        "._z.mcap": "",
        "b.mcap": "",
    },
    "other names": {"r/a.mcap": "", "r/b.mcap": "", "r/metadata.yaml": "  - a.mcap\n  - b.mcap\n"},
    "a missing file": {
        "r_0.mcap": "",
        "r_2.mcap": "",
        "metadata.yaml": "  - r_0.mcap\n  - r_1.mcap\n  - r_2.mcap\n",
    },
}


@pytest.mark.parametrize("layout", LAYOUTS)
def test_logs_have_the_same_names_in_a_bucket_and_in_a_folder(layout, stores, tmp_path):
    url = "s3://bucket/logs"
    for name, text in LAYOUTS[layout].items():
        content = (LISTED + text if text else name).encode()
        open_place(url).put(name, content)
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / name).write_bytes(content)

    def files(place, *, join: bool) -> dict[str, list[str]]:
        logs = list_logs(place, join=join)
        named = {log["log"]: [Path(f["key"]).name for f in log["files"]] for log in logs}
        return {log: [name for name in names if "yaml" not in name] for log, names in named.items()}

    for join in (True, False):
        assert files(url, join=join) == files(tmp_path, join=join)
    assert all(len(names) == 1 for names in files(url, join=False).values())


def test_a_bucket_without_logs_is_an_error(stores):
    with pytest.raises(InputError, match="no logs"):
        list_logs("s3://bucket/nothing")


def test_each_log_is_in_one_share_that_does_not_depend_on_other_logs():
    logs = [{"name": f"log{i}"} for i in range(100)]
    shares = [share_of(logs, f"{k}/7") for k in range(1, 8)]
    assert sorted(log["name"] for share in shares for log in share) == sorted(
        log["name"] for log in logs
    )
    assert all(share for share in shares)
    assert share_of(logs[:50], "3/7") == [log for log in shares[2] if log in logs[:50]]
    for wrong in ("0/3", "4/3", "1", "a/b", "-1/2", ""):
        with pytest.raises(ConfigError):
            share_of(logs, wrong)
