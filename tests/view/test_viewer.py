"""The viewer is a new one, on ports of its own, and its address is clean."""

import socket
import sys
from types import SimpleNamespace
from urllib.parse import parse_qs, urlsplit

import pytest

from workcell.errors import InputError
from workcell.view import viewer
from workcell.view.palette import ARM_COLOURS, COMMANDED, LIMIT, MEASURED


def test_a_viewer_left_over_is_not_mistaken_for_the_new_one(tmp_path, monkeypatch):
    """Somebody listens on the usual ports: the new viewer gets others."""
    rrd = tmp_path / "recording.rrd"
    rrd.write_bytes(b"")
    started = []
    monkeypatch.setattr(
        viewer.subprocess,
        "Popen",
        lambda command, **_: started.append(command) or SimpleNamespace(),
    )
    with socket.socket() as first, socket.socket() as second:
        for left_over in (first, second):
            left_over.bind(("127.0.0.1", 0))
            left_over.listen()
        taken = [s.getsockname()[1] for s in (first, second)]
        monkeypatch.setattr(viewer, "DATA_PORT", taken[0])
        monkeypatch.setattr(viewer, "WEB_PORT", taken[1])
        opened = viewer.open_viewer(rrd, web=True)
    assert opened.data_port not in taken
    assert opened.web_port not in taken
    (command,) = started
    assert command[command.index("--port") + 1] == str(opened.data_port)
    assert command[command.index("--web-viewer-port") + 1] == str(opened.web_port)
    address = urlsplit(opened.address)
    assert address.port == opened.web_port
    source = parse_qs(address.query)["url"]
    assert source == [f"rerun+http://127.0.0.1:{opened.data_port}/proxy"]
    for port in (opened.data_port, opened.web_port):
        assert f"-L {port}:127.0.0.1:{port}" in opened.ssh_command


def luminance(colour):
    """Relative luminance by WCAG 2."""
    linear = [
        c / 12.92 if c <= 0.04045 else ((c + 0.055) / 1.055) ** 2.4
        for c in (x / 255 for x in colour)
    ]
    return 0.2126 * linear[0] + 0.7152 * linear[1] + 0.0722 * linear[2]


def contrast(a, b):
    high, low = sorted((luminance(a), luminance(b)), reverse=True)
    return (high + 0.05) / (low + 0.05)


@pytest.mark.parametrize("ground", [(255, 255, 255), (13, 16, 17)])
def test_curves_are_told_from_a_light_and_a_dark_ground(ground):
    """3 to 1 is what WCAG asks of graphics; the orange of an arm is a little lighter on white."""
    for colour in (MEASURED, COMMANDED, LIMIT, *ARM_COLOURS):
        assert contrast(colour, ground) > 2.8, colour


@pytest.mark.skipif(sys.platform != "linux", reason="other systems have a display without a name")
def test_without_a_display_the_window_is_refused_and_the_browser_is_named(tmp_path, monkeypatch):
    rrd = tmp_path / "recording.rrd"
    rrd.write_bytes(b"")
    for name in viewer.DISPLAYS:
        monkeypatch.delenv(name, raising=False)
    with pytest.raises(InputError, match=r"there is no display .* --web"):
        viewer.open_viewer(rrd)
