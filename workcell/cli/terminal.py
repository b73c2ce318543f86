"""What all commands share: exit statuses, the two streams, progress, and the table of verdicts."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn, TimeRemainingColumn
from rich.table import Table
from rich.text import Text

OK, FAILED, REFUSED = 0, 1, 2
"""Exit statuses: as expected; it ran, but not as expected; the input was refused."""

# Names and paths may hold brackets and colons, which are not for rich to interpret.
stdout = Console(highlight=False, soft_wrap=True, markup=False, emoji=False)
narrow = Console(highlight=False, markup=False, emoji=False)
"""The same stream for tables: wrapped at the terminal's width, 80 columns where there is none."""
stderr = Console(stderr=True, highlight=False, soft_wrap=True, markup=False, emoji=False)


def report(summary: dict, folder: Path) -> None:
    """Say what was expected, what came out, and what stopped the run."""
    table = Table("expectation", "wanted", "measured", "held", box=None)
    for name, verdict in summary["expectations"].items():
        table.add_row(
            name,
            verdict["wanted"],
            verdict["measured"],
            Text("yes") if verdict["held"] else Text("NO", style="red"),
        )
    if summary["expectations"]:
        stdout.print(table)
    for one, other, reason in summary.get("ignored_pairs", ()):
        stderr.print(f"NOT held apart: {one} and {other} ({reason}); you answer for it")
    for sentence in summary.get("why", ()):
        stderr.print(sentence)
    stdout.print(
        f"{summary['scenario']}: {'all expectations held' if summary['held'] else 'NOT as expected'}; {folder}"
    )


class Bar:
    """A progress bar that says what it is doing."""

    def __init__(self, bar: Progress, what: str):
        self._bar, self._what = bar, what
        self._task = bar.add_task(what, total=None)

    def __call__(self, done: int, total: int) -> None:
        """So much of it is done."""
        self._bar.update(self._task, completed=done, total=total)

    def phase(self, name: str) -> None:
        """Something else begins, of which nothing is done yet."""
        self._bar.reset(self._task, description=f"{self._what}: {name}", total=None)


@contextmanager
def progress_bar(what: str) -> Iterator[Bar | None]:
    """A progress bar on a terminal, nothing elsewhere."""
    if not stderr.is_terminal:
        yield None
        return
    with Progress(
        TextColumn("{task.description}"),
        BarColumn(),
        TextColumn("{task.percentage:>3.0f}%"),
        TimeRemainingColumn(),
        console=stderr,
    ) as bar:
        yield Bar(bar, what)
