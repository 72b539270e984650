"""The description of the package: the README without pictures and links that only a clone has."""

import re
from pathlib import Path
from typing import Any

from hatchling.metadata.plugin.interface import MetadataHookInterface

_IN_CLONE = r"\((?![a-z]+:)[^)\s]*\)"
"""Target of a link to a file next to the README."""


def without_files(text: str) -> str:
    """Return Markdown without pictures from files, and with plain text for links to files."""
    text = re.sub(rf"^!\[[^\]]*\]{_IN_CLONE}\n\n", "", text, flags=re.M)
    return re.sub(rf"\[([^\]]*)\]{_IN_CLONE}", r"\1", text)


class Description(MetadataHookInterface):
    """Metadata hook of hatchling."""

    def update(self, metadata: dict[str, Any]) -> None:
        """Set the description."""
        text = without_files((Path(self.root) / "README.md").read_text(encoding="utf-8"))
        metadata["readme"] = {"content-type": "text/markdown", "text": text}
