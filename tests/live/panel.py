"""A panel of the live page without a browser: a socket that speaks as the page's script does."""

from __future__ import annotations

import http.client
import json
import time
from urllib.parse import urlsplit

from websockets.sync.client import connect

from workcell.live.server import HOST, PANEL


class Panel:
    """What the page's script would say."""

    def __init__(self, address: str):
        url = urlsplit(address)
        port = url.port
        line = http.client.HTTPConnection(HOST, port, timeout=10)
        line.request("GET", f"/?{url.query}")
        cookie = line.getresponse().getheader("Set-Cookie").partition(";")[0]
        line.close()
        self.socket = connect(f"ws://{HOST}:{port}{PANEL}", additional_headers={"Cookie": cookie})
        self.hello = self.hear("hello")

    def hear(self, kind: str) -> dict:
        until_s = time.monotonic() + 20.0
        while time.monotonic() < until_s:
            message = json.loads(self.socket.recv(timeout=20.0))
            if message["kind"] == kind:
                return message
        raise TimeoutError(kind)

    def say(self, kind: str, **more) -> None:
        self.socket.send(json.dumps({"kind": kind, **more}))

    def hold(self, *codes: str, **more) -> None:
        self.say("alive", **({"held": codes, "slow": False, "clutch": False, "axes": None} | more))

    def close(self) -> None:
        self.socket.close()


def until(condition, limit_s: float = 10.0) -> bool:
    end_s = time.monotonic() + limit_s
    while time.monotonic() < end_s:
        if condition():
            return True
        time.sleep(0.01)
    return condition()
