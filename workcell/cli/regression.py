"""The commands that hold runs against each other: compare, reproduce, bless, salvage.

Exit status as everywhere: 0 the same, or done; 1 it differs; 2 refused, or not comparable.
"""

from __future__ import annotations

import functools
import tempfile
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import tyro
from rich.console import Console
from rich.table import Table

from workcell.cli.extras import needs
from workcell.cli.terminal import narrow, stderr, stdout
from workcell.errors import InputError

if TYPE_CHECKING:
    from workcell.regression.compare import Comparison
    from workcell.regression.excerpt import Excerpt
    from workcell.regression.reference import MetricChange
    from workcell.trace.table import Trace

SAME, DIFFERS, NOT_COMPARABLE = 0, 1, 2
SHOWN = 8
"""Lines of the table on the terminal; the file has them all."""
REPORT = "comparison"
"""Name of what is written into the run folder, before its ending."""

Run = Annotated[
    Path, tyro.conf.Positional, tyro.conf.arg(metavar="RUN", help="a run folder or a trace")
]
References = Annotated[
    Path, tyro.conf.arg(metavar="DIR", help="folder with a reference for each scenario")
]


def compare(
    run: Run,
    reference: Annotated[
        Path,
        tyro.conf.Positional,
        tyro.conf.arg(metavar="REFERENCE", help="a run folder, a trace, or a folder `bless` made"),
    ],
    /,
    ticks: Annotated[
        bool,
        tyro.conf.arg(help="tick by tick instead: where they part, and which quantity moved first"),
    ] = False,
    plot: Annotated[bool, tyro.conf.arg(help="draw what differs into comparison.png")] = False,
    rerun: Annotated[bool, tyro.conf.arg(help="open both in one recording in the viewer")] = False,
    other_settings: Annotated[
        bool, tyro.conf.arg(help="compare although settings of the scenario differ")
    ] = False,
    wide: Annotated[
        bool, tyro.conf.arg(help="tolerances for two closed loops on different machines")
    ] = False,
) -> int:
    """Say in words what a run does differently from another: later, nearer, more waits. With --ticks (and for references): where they part. Exit status 0 same, 1 differs, 2 not comparable."""
    from workcell.regression import reference as regression
    from workcell.regression.compare import compare as compare_excerpts
    from workcell.regression.excerpt import excerpt
    from workcell.trace.table import load

    mine, changes = load(run), None
    if not (ticks or plot or rerun or other_settings or wide or regression.is_reference(reference)):
        return _in_words(mine, load(reference))
    if regression.is_reference(reference):
        kept = regression.load(reference)
        theirs, wide = kept.rows("closed"), True
    else:
        kept, theirs = None, excerpt(load(reference))
    options = regression.CLOSED if wide else {}
    result = compare_excerpts(excerpt(mine), theirs, other_settings=other_settings, **options)
    if kept is not None and result.kind != "not comparable":
        changes = regression.metric_changes_of_trace(mine, kept.metrics)
    folder = run if run.is_dir() else run.parent
    report(result, folder / f"{REPORT}.txt", changes or ())
    if result.kind == "not comparable":
        return NOT_COMPARABLE
    _show(excerpt(mine), theirs, result, folder, plot=plot, rerun=rerun)
    return SAME if result.kind == "same" and not changes else DIFFERS


def _in_words(run: Trace, reference: Trace) -> int:
    """Print what a person would ask of two runs; 1 if anything is told."""
    from workcell.regression.words import compare_in_words

    words = compare_in_words(run, reference)
    if words.settings:
        table = Table("parameter", "run", "reference", box=None, padding=(0, 1))
        for change in words.settings[:SHOWN]:
            table.add_row(change.key, _value(change.run), _value(change.reference))
        narrow.print(table)
        if len(words.settings) > SHOWN:
            narrow.print(f"... and {len(words.settings) - SHOWN} parameters more")
        narrow.print()
    table = Table(box=None, padding=(0, 1))
    table.add_column("quantity")
    table.add_column("run", justify="right")
    table.add_column("reference", justify="right")
    table.add_column("difference")
    for figure in words.figures:
        a, b = (
            "none" if x is None else f"{x:.4g} {figure.unit}".strip()
            for x in (figure.run, figure.reference)
        )
        table.add_row(figure.name, a, b, figure.difference)
    narrow.print(table)
    for remark in words.remarks:
        narrow.print(remark, markup=False)
    narrow.print(words.headline(), markup=False)
    return SAME if words.same else DIFFERS


def _value(value: Any) -> str:
    return "none" if value is None else str(value).replace("[", r"\[")


def reproduce(
    run: Run,
    /,
    open_loop: Annotated[
        bool, tyro.conf.arg(help="feed the recorded states to the controller, without a plant")
    ] = False,
    closed_loop: Annotated[bool, tyro.conf.arg(help="run the scenario again")] = False,
    out: Annotated[
        Path | None, tyro.conf.arg(metavar="DIR", help="keep the new trace here")
    ] = None,
) -> int:
    """Do a recorded run again with today's controller and compare. Exit status 0 same, 1 differs, 2 not comparable."""
    from workcell import run as runner
    from workcell.regression import reference as regression
    from workcell.regression import replay
    from workcell.regression.compare import compare as compare_excerpts
    from workcell.regression.excerpt import excerpt
    from workcell.regression.rows import states
    from workcell.trace.table import load

    if open_loop == closed_loop:
        raise InputError("reproduce: allowed is exactly one of --open-loop and --closed-loop")
    old = load(run)
    scenario = replay.scenario_of(old)
    with tempfile.TemporaryDirectory() as temporary:
        folder = out or Path(temporary)
        if open_loop:
            cell = runner.prepare(scenario, folder / runner.SCENE_FOLDER)
            again = replay.open_loop(cell, states(old), folder)
            changes, options = (), {"without_plant": True}
        else:
            again = replay.closed_loop(scenario, folder)
            # Both from their traces: the summary has the independent judge's figures instead of some of them.
            changes = regression.metric_changes_of_trace(again.trace, regression.metrics_of(old))
            options = regression.CLOSED
        result = compare_excerpts(excerpt(again.trace), excerpt(old), **options)
        if again.fault:
            stdout.print(f"stopped: {again.fault}", markup=False)
        report(result, out / f"{REPORT}.txt" if out else None, changes)
    if result.kind == "not comparable":
        return NOT_COMPARABLE
    return SAME if result.kind == "same" and not changes else DIFFERS


@functools.wraps(reproduce)
def rerun(*arguments: Any, **options: Any) -> int:
    stderr.print("`workcell rerun` is called `workcell reproduce` now: rerun is the viewer's name")
    return reproduce(*arguments, **options)


rerun.__doc__ = "The old name of `reproduce`, which does the same."


def bless(
    scenario: Annotated[str, tyro.conf.Positional, tyro.conf.arg(metavar="SCENARIO")],
    /,
    reason: str,
    references: References = Path("tests/replay/references"),
    out: Annotated[
        Path | None, tyro.conf.arg(metavar="DIR", help="keep the runs it took here")
    ] = None,
    set: Annotated[
        tyro.conf.UseAppendAction[tuple[str, ...]],
        tyro.conf.arg(
            name="set", metavar="KEY=VALUE", help="settings of the reference run, as for `run`"
        ),
    ] = (),
) -> int:
    """Make what a scenario does now its reference. Refused without a reason, or if an expectation is broken."""
    from workcell.regression.bless import bless as make_reference

    with tempfile.TemporaryDirectory() as temporary:
        changes = make_reference(
            scenario, references, reason, out=out or Path(temporary), overrides=set or None
        )
    _metrics_table(changes)
    stdout.print(f"blessed: {references}; {len(changes)} metrics changed", markup=False)
    return SAME


def salvage(
    run: Run,
    /,
    out: Annotated[
        Path | None, tyro.conf.arg(metavar="DIR", help="new folder; default RUN/salvaged")
    ] = None,
) -> int:
    """Make a run folder of what is intact of a damaged one, for replay, plot and compare. Exit status 1 if no row was left."""
    from workcell.regression.restore import restore

    folder = out or run / "salvaged"
    saved = restore(run, folder)
    for loss in saved.losses:
        stdout.print(f"lost: {loss}", markup=False)
    stdout.print(f"{saved.rows} rows in {saved.trace or 'no trace'}", markup=False)
    stdout.print(f"recording: {saved.recording or 'nothing left'}", markup=False)
    return SAME if saved.trace else DIFFERS


def report(
    result: Comparison, file: Path | None, changes: tuple[MetricChange, ...] | list[MetricChange]
) -> None:
    """Say on the terminal what matters, and in the file everything."""
    if changes:
        _metrics_table(changes)
    table = _table(result)
    if result.differences:
        stdout.print(_table(result, SHOWN))
        if len(result.differences) > SHOWN:
            stdout.print(f"... and {len(result.differences) - SHOWN} quantities more")
    for note in result.notes:
        stdout.print(f"note: {note}", markup=False)
    stdout.print(result.headline(), markup=False)
    if file is None:
        return
    with file.open("w", encoding="utf-8") as stream:
        long = Console(file=stream, width=160, highlight=False, markup=False)
        long.print(f"{result.run}\nagainst {result.reference}\n{result.headline()}\n", markup=False)
        for note in result.notes:
            long.print(f"note: {note}", markup=False)
        long.print(table)
        for change in changes:
            long.print(f"{change.name}: {change.reference} -> {change.now}", markup=False)
    stdout.print(f"all of it: {file}", markup=False)


def _table(result: Comparison, most: int | None = None) -> Table:
    table = Table(
        "quantity", "stage", "first tick", "at", "ticks", "largest", "there", "run", "reference",
        box=None,
    )  # fmt: skip
    for d in result.differences[:most]:
        table.add_row(
            d.column + ("" if d.entry is None else f"[{d.entry}]"),
            d.stage,
            str(d.first_tick),
            f"{d.first_time_s:.3f} s",
            str(d.ticks),
            "" if d.largest is None else f"{d.largest:.3g}",
            str(d.largest_tick),
            d.run,
            d.reference,
        )
    return table


def _metrics_table(changes: tuple[MetricChange, ...] | list[MetricChange]) -> None:
    table = Table("metric", "reference", "now", box=None)
    for change in changes[:SHOWN]:
        table.add_row(change.name, str(change.reference), str(change.now))
    stdout.print(table)
    if len(changes) > SHOWN:
        stdout.print(f"... and {len(changes) - SHOWN} metrics more")


def _show(
    run: Excerpt, reference: Excerpt, result: Comparison, folder: Path, *, plot: bool, rerun: bool
) -> None:
    """Draw both, on paper or in the viewer."""
    if plot:
        needs("matplotlib", "figures")
        from workcell.regression import overlay

        stdout.print(str(overlay.draw(run, reference, result, folder / f"{REPORT}.png")))
    if rerun:
        from workcell.regression import recording_of_both as view_both
        from workcell.view.viewer import open_viewer

        recording = view_both.record(run, reference, result, folder / f"{REPORT}.rrd")
        stdout.print(str(recording))
        open_viewer(recording).process.wait()
