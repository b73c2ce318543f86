import pytest

from workcell.signals import ARM_SIGNALS, CELL_SIGNALS, STAGES, Layout, columns

SUFFIXES = {
    "s": "_s", "m": "_m", "rad": "_rad", "m/s": "_m_s", "rad/s": "_rad_s", "1/s": "_per_s",
    "1/m": "_per_m",
}  # fmt: skip
WITHOUT_SUFFIX = {
    "qpos",
    "qvel",
    "plant_qpos",
    "plant_qvel",
}  # Their names are MuJoCo's, fixed by the trace contract.


def layout(arms=("surgeon", "nurse")):
    return Layout(arms=arms, joints=("a", "b"), nq=3, nv=2, pairs=(("g", "h"),) * 5)


def test_the_contract_of_the_trace_is_kept():
    cell = (
        "time_s qpos qvel wanted_rad_s command_rad_s pair_distance_m pair_rate_m_s ttc_s ttc_pair "
        "ttc_command_s mode"
    )
    arm = (
        "scale artc_per_s armd_per_m tool_position_m tool_wxyz tool_speed_m_s tool_error_m "
        "tool_error_rad"
    )
    names = [column.name for column in columns(layout())]
    promised = cell.split() + [f"{a}.{n}" for a in ("surgeon", "nurse") for n in arm.split()]
    assert set(promised) <= set(names)
    assert len(names) == len(set(names))


@pytest.mark.parametrize("signal", CELL_SIGNALS + ARM_SIGNALS, ids=lambda s: s.name)
def test_each_signal_is_fully_described(signal):
    assert signal.stage in STAGES
    assert signal.meaning
    if signal.dtype == "float64":
        assert signal.atol > 0
        assert signal.rtol >= 0
        if signal.name not in WITHOUT_SUFFIX:
            assert signal.name.endswith(SUFFIXES.get(signal.unit, ""))
    else:
        assert (signal.shape, signal.atol, signal.rtol) == ("scalar", 0, 0)


def test_widths_follow_from_the_layout():
    widths = {column.name: column.width for column in columns(layout(("nurse",)))}
    assert widths["qpos"] == 3
    assert widths["qvel"] == widths["command_rad_s"] == 2
    assert widths["pair_distance_m"] == 5
    assert widths["nurse.tool_position_m"] == 3
    assert widths["nurse.tool_wxyz"] == 4
    assert widths["nurse.scale"] is None
