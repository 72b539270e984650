"""Files of the report: Markdown with pictures, one HTML file, and JSON."""

import base64
import html
import json
from collections.abc import Mapping, Sequence
from pathlib import Path

from benchmarks.paper.section import Block, Picture, Section, Table, Text

STYLE = """
body{font:16px/1.55 system-ui,sans-serif;color:#2b3038;max-width:1080px;
margin:2rem auto;padding:0 1rem}
h1{font-size:1.7rem}h2{margin-top:2.6rem;border-top:1px solid #dfe3e8;padding-top:1.4rem}
table{border-collapse:collapse;font-size:.86rem;margin:.8rem 0;display:block;overflow-x:auto}
td,th{padding:.28rem .7rem;border-bottom:1px solid #e6e9ed;text-align:left;white-space:nowrap}
td.long{white-space:normal;min-width:18rem}
th{background:#f4f6f8}tr:hover td{background:#fafbfc}
figure{margin:1rem 0}img{max-width:100%}figcaption,.caption{font-size:.86rem;color:#5f6874}
"""


def write(folder: Path, title: str, sections: Sequence[Section], facts: Mapping[str, str]) -> None:
    """Write ``report.md``, ``figures/`` and ``report.html`` into a folder."""
    pictures = folder / "figures"
    pictures.mkdir(parents=True, exist_ok=True)
    for section in sections:
        for block in section.blocks:
            if isinstance(block, Picture):
                (pictures / f"{block.name}.png").write_bytes(block.png)
    (folder / "report.md").write_text(markdown(title, sections, facts), encoding="utf-8")
    (folder / "report.html").write_text(page(title, sections, facts), encoding="utf-8")


def write_json(path: Path, sections: Sequence[Section], facts: Mapping[str, str]) -> None:
    """Write all figures and the facts of the run."""
    figures = [figure.to_dict() for section in sections for figure in section.figures]
    path.parent.mkdir(parents=True, exist_ok=True)
    text = json.dumps({"run": dict(facts), "figures": figures}, indent=1)
    path.write_text(text + "\n", encoding="utf-8")


def markdown(title: str, sections: Sequence[Section], facts: Mapping[str, str]) -> str:
    """Return the report as Markdown."""
    parts = [f"# {title}", *(f"- {name}: {value}" for name, value in facts.items())]
    contents = [f"{n}. {section.title}" for n, section in enumerate(sections, 1)]
    text = "\n".join([parts[0], "", *parts[1:], "", "## Contents", "", *contents, ""])
    for section in sections:
        body = "\n\n".join(_markdown_block(block) for block in section.blocks)
        text += f"\n## {section.title}\n\n{body}\n"
    return text


def _markdown_block(block: Block) -> str:
    if isinstance(block, Text):
        return block.text
    if isinstance(block, Picture):
        return f"![{block.caption}](figures/{block.name}.png)\n\n{block.caption}"
    rows = [block.header, tuple("---" for _ in block.header), *block.rows]
    lines = ["| " + " | ".join(cell.replace("|", "/") for cell in row) + " |" for row in rows]
    caption = [block.caption, ""] if block.caption else []
    return "\n".join([*caption, *lines])


def page(title: str, sections: Sequence[Section], facts: Mapping[str, str]) -> str:
    """Return the report as one self-contained HTML file."""
    contents = "".join(
        f"<li><a href='#{section.name}'>{html.escape(section.title)}</a></li>"
        for section in sections
    )
    items = "".join(
        f"<li>{html.escape(name)}: {html.escape(value)}</li>" for name, value in facts.items()
    )
    body = "".join(
        f"<h2 id='{section.name}'>{html.escape(section.title)}</h2>"
        + "".join(_html_block(block) for block in section.blocks)
        for section in sections
    )
    return (
        f"<!doctype html><html lang='en'><meta charset='utf-8'><title>{html.escape(title)}</title>"
        f"<style>{STYLE}</style><h1>{html.escape(title)}</h1><ul>{items}</ul>"
        f"<h2>Contents</h2><ol>{contents}</ol>{body}</html>\n"
    )


def _html_block(block: Block) -> str:
    if isinstance(block, Text):
        return f"<p>{html.escape(block.text)}</p>"
    if isinstance(block, Picture):
        data = base64.b64encode(block.png).decode()
        caption = html.escape(block.caption)
        return (
            f"<figure><img alt='{caption}' src='data:image/png;base64,{data}'>"
            f"<figcaption>{caption}</figcaption></figure>"
        )
    return _html_table(block)


def _html_table(block: Table) -> str:
    head = "".join(f"<th>{html.escape(cell)}</th>" for cell in block.header)
    rows = "".join("<tr>" + "".join(map(_cell, row)) + "</tr>" for row in block.rows)
    caption = f"<p class='caption'>{html.escape(block.caption)}</p>" if block.caption else ""
    return f"{caption}<table><tr>{head}</tr>{rows}</table>"


def _cell(text: str) -> str:
    kind = " class='long'" if len(text) > 45 else ""
    return f"<td{kind}>{html.escape(text)}</td>"
