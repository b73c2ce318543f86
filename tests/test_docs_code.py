"""The Python blocks of the pages that teach are run, one after the other, in an empty folder."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

DOCS = Path(__file__).parents[1] / "docs"
PAGES = ("parts.md", "session.md", "environments.md", "robot.md")


@pytest.mark.parametrize("page", PAGES)
def test_the_blocks_of_a_page_run(page, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    text, names = (DOCS / page).read_text(encoding="utf-8"), {"__name__": "__main__"}
    blocks = list(re.finditer(r"```python\n(.*?)```", text, flags=re.S))
    assert blocks
    for block in blocks:
        # Lines are numbered as in the page, so that a failure points into it.
        before = "\n" * text[: block.start(1)].count("\n")
        exec(compile(before + block[1], str(DOCS / page), "exec"), names)
    assert capsys.readouterr().out
