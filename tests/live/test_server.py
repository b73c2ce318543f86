"""The page's server: this machine only, the token or nothing, a taken port by name."""

from __future__ import annotations

import http.client
import json
import socket
from pathlib import Path

import pytest
import websockets.asyncio.server as sockets
from websockets.exceptions import InvalidStatus
from websockets.sync.client import connect

from workcell.errors import InputError
from workcell.live import server as module
from workcell.live.server import HOST, PANEL, PageServer, ssh_command


class Ears:
    """Remembers what it was told."""

    def __init__(self):
        self.told = []

    def came(self, browser):
        self.told.append(("came", browser))

    def went(self, browser):
        self.told.append(("went", browser))

    def heard(self, browser, message):
        self.told.append((message["kind"], browser))


@pytest.fixture(scope="module")
def served():
    ears = Ears()
    page = PageServer(0, title="a test", listener=ears)
    yield page, ears
    page.close()


def ask(port, path="/", **headers):
    line = http.client.HTTPConnection(HOST, port, timeout=10)
    try:
        line.request("GET", path, headers=headers)
        answer = line.getresponse()
        return answer.status, dict(answer.getheaders()), answer.read()
    finally:
        line.close()


def cookie(page):
    status, headers, _ = ask(page.port, f"/?token={page.token}")
    assert status == 302
    return headers["Set-Cookie"].partition(";")[0], headers


def test_the_token_opens_the_page_and_leaves_the_address_bar(served):
    page, _ = served
    pass_, headers = cookie(page)
    assert headers["Location"] == "/"
    assert "HttpOnly" in headers["Set-Cookie"]
    assert "SameSite=Strict" in headers["Set-Cookie"]
    status, _, body = ask(page.port, Cookie=pass_)
    assert status == 200
    assert b"<title>a test</title>" in body
    assert b"/panel.js" in body
    for file in ("/panel.js", "/panel.css"):
        assert ask(page.port, file, Cookie=pass_)[0] == 200
    assert ask(page.port, "/../server.py", Cookie=pass_)[0] == 404


@pytest.mark.parametrize(
    ("path", "headers"),
    [
        ("/", {}),
        ("/panel.js", {}),
        ("/?token=", {}),
        ("/?token=wrong", {}),
        ("/", {"Cookie": "workcell_{port}=wrong.browser"}),
        ("/", {"Cookie": "workcell_{port}="}),
        ("/", {"Cookie": '=;;=,"workcell'}),
        ("/?token={token}", {"Host": "evil.example:{port}"}),
        ("/?token={token}", {"Origin": "http://evil.example"}),
    ],
)
def test_without_the_token_there_is_nothing(served, path, headers):
    page, _ = served
    known = {"port": page.port, "token": page.token}
    headers = {key: value.format(**known) for key, value in headers.items()}
    status, answered, body = ask(page.port, path.format(**known), **headers)
    assert status == 403
    assert "Set-Cookie" not in answered
    assert body == module.REFUSAL.encode()


@pytest.mark.parametrize("path", ["/", PANEL, "/?token=wrong"])
def test_without_the_token_no_socket_opens(served, path):
    page, _ = served
    for headers in ({}, {"Cookie": f"workcell_{page.port}=wrong.x"}):
        with pytest.raises(InvalidStatus) as refused:
            connect(f"ws://{HOST}:{page.port}{path}", additional_headers=headers)
        assert refused.value.response.status_code == 403


def test_a_foreign_page_cannot_use_the_cookie_of_this_one(served):
    page, _ = served
    headers = {"Cookie": cookie(page)[0]}
    with pytest.raises(InvalidStatus):
        connect(
            f"ws://{HOST}:{page.port}{PANEL}",
            additional_headers=headers,
            origin="http://evil.example",
        )


def test_panels_are_told_apart_by_browser_and_closed_when_they_talk_nonsense(served):
    page, ears = served
    url, headers = f"ws://{HOST}:{page.port}{PANEL}", {"Cookie": cookie(page)[0]}
    browser = headers["Cookie"].partition(".")[2]
    with connect(url, additional_headers=headers) as panel:
        panel.send(json.dumps({"kind": "hello"}))
        page.send({"kind": "state"}, browser=browser)
        assert json.loads(panel.recv(timeout=10)) == {"kind": "state"}
        for nonsense in ("{", "[]", '{"kind": 1}', "[" * 100_000):
            with connect(url, additional_headers={"Cookie": cookie(page)[0]}) as other:
                other.send(nonsense)
                with pytest.raises(Exception, match="1007"):
                    other.recv(timeout=10)
        panel.ping().wait(10)
    assert ("hello", browser) in ears.told


def test_it_listens_on_this_machine_only(served):
    page, _ = served
    listening = Path("/proc/net/tcp").read_text() if Path("/proc/net/tcp").exists() else ""
    if not listening:
        pytest.skip("this system does not list its sockets")
    port = f"{page.port:04X}"
    local = {line.split()[1] for line in listening.splitlines() if line.split()[3] == "0A"}
    assert {address for address in local if address.endswith(f":{port}")} == {f"0100007F:{port}"}


def test_viser_cannot_open_its_tunnel(served):
    page, _ = served
    assert page.viser.request_share_url() is None


def test_a_taken_port_is_named():
    with socket.socket() as other:
        other.bind((HOST, 0))
        other.listen()
        port = other.getsockname()[1]
        with pytest.raises(InputError, match=rf"--port {port}: .*in use.*--port N"):
            PageServer(port, title="", listener=Ears())
    with pytest.raises(InputError, match="--port 70000"):
        PageServer(70000, title="", listener=Ears())


def test_a_server_that_cannot_be_guarded_is_not_started(monkeypatch):
    """As if an update of viser called something else than what is wrapped."""
    serve = sockets.serve

    def unguarded(self):
        import contextlib

        return contextlib.nullcontext()

    monkeypatch.setattr(PageServer, "_wrapped", unguarded)
    with pytest.raises(InputError, match="cannot be guarded"):
        PageServer(0, title="", listener=Ears())
    assert sockets.serve is serve


def test_the_ssh_command_forwards_the_port():
    assert "-L 8080:127.0.0.1:8080" in ssh_command(8080)
