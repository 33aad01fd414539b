"""A headless Chromium, spoken to through its debugging pipe: fields of JSON that end in a NUL."""

from __future__ import annotations

import base64
import json
import os
import select
import shutil
import subprocess
import time
from io import BytesIO
from pathlib import Path

import numpy as np
from matplotlib.image import imread

PROGRAM = shutil.which("chromium") or shutil.which("chromium-browser")
_OPTIONS = (
    "--headless", "--no-sandbox", "--disable-gpu", "--disable-quic", "--no-first-run",
    "--disable-background-networking", "--disable-component-update", "--disable-sync",
    "--remote-debugging-pipe", "--hide-scrollbars",
)  # fmt: skip


class Browser:
    """One page in a browser with a profile of its own; complaints of the page are collected.

    Attributes:
        complaints: errors and warnings of scripts, of the console, of the policy, in words.
    """

    def __init__(self, profile: Path, timeout: float = 120.0) -> None:
        self._timeout, self._count, self._rest = timeout, 0, b""
        self.complaints: list[str] = []
        theirs, self._out = os.pipe()
        self._in, answers = os.pipe()
        # Chromium reads from descriptor 3 and writes to 4, whatever ours are.
        words = ["bash", "-c", f'exec "$@" 3<&{theirs} 4>&{answers}', "bash", str(PROGRAM)]
        self._process = subprocess.Popen(
            [*words, *_OPTIONS, f"--user-data-dir={profile}", "about:blank"],
            pass_fds=(theirs, answers),
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
        )
        os.close(theirs)
        os.close(answers)
        self._session = ""
        pages = self._call("Target.getTargets")["targetInfos"]
        page = next(each["targetId"] for each in pages if each["type"] == "page")
        asked = {"targetId": page, "flatten": True}
        self._session = self._call("Target.attachToTarget", asked)["sessionId"]
        for part in ("Page", "Runtime", "Log"):
            self._call(f"{part}.enable")

    def __enter__(self) -> Browser:
        return self

    def __exit__(self, *_: object) -> None:
        os.close(self._out)
        os.close(self._in)
        self._process.terminate()
        self._process.wait(timeout=30.0)

    def show(self, path: Path, width: int, *, script: bool = True) -> None:
        """Open a file at a width in pixels."""
        size = {"width": width, "height": 900, "deviceScaleFactor": 1, "mobile": width < 500}
        self._call("Emulation.setDeviceMetricsOverride", size)
        self._call("Emulation.setScriptExecutionDisabled", {"value": not script})
        self.media("screen")
        self._call("Page.navigate", {"url": path.resolve().as_uri()})
        self._wait_for("document.readyState === 'complete' && location.protocol === 'file:'")

    def media(self, kind: str) -> None:
        """Show on "screen" or in "print"."""
        self._call("Emulation.setEmulatedMedia", {"media": kind})

    def value(self, expression: str) -> object:
        """What a script gives."""
        asked = {"expression": expression, "returnByValue": True, "awaitPromise": True}
        found = self._call("Runtime.evaluate", asked)
        assert "exceptionDetails" not in found, found
        return found["result"].get("value")

    def press(self, key: str) -> None:
        """Press and release a key, by its name in scripts."""
        codes = {" ": 32, "Home": 36, "End": 35, "ArrowLeft": 37, "ArrowRight": 39, "Tab": 9}
        asked = {"key": key, "code": "Space" if key == " " else key}
        asked |= {"windowsVirtualKeyCode": codes[key]}
        text = {"text": " "} if key == " " else {}
        self._call("Input.dispatchKeyEvent", {"type": "keyDown", **asked, **text})
        self._call("Input.dispatchKeyEvent", {"type": "keyUp", **asked})

    def picture(self) -> np.ndarray:
        """(h, w, 4) what is seen, 0 to 1."""
        png = self._call("Page.captureScreenshot", {"format": "png"})["data"]
        return imread(BytesIO(base64.b64decode(png)))

    def paper(self) -> bytes:
        """The page as PDF."""
        return base64.b64decode(self._call("Page.printToPDF")["data"])

    def _wait_for(self, expression: str) -> None:
        end = time.monotonic() + self._timeout
        while not self.value(expression):
            assert time.monotonic() < end, f"never came: {expression}"
            time.sleep(0.02)

    def _call(self, method: str, asked: dict | None = None) -> dict:
        self._count += 1
        words = {"id": self._count, "method": method, "params": asked or {}}
        if self._session:
            words["sessionId"] = self._session
        os.write(self._out, json.dumps(words).encode() + b"\0")
        while True:
            said = self._read()
            if said.get("id") == self._count:
                assert "error" not in said, (method, said)
                return said["result"]
            self._note(said)

    def _read(self) -> dict:
        while b"\0" not in self._rest:
            ready, _, _ = select.select([self._in], [], [], self._timeout)
            assert ready, "the browser says nothing"
            more = os.read(self._in, 1 << 20)
            assert more, "the browser has ended"
            self._rest += more
        said, _, self._rest = self._rest.partition(b"\0")
        return json.loads(said)

    def _note(self, said: dict) -> None:
        told = said.get("params", {})
        match said["method"]:
            case "Runtime.exceptionThrown":
                self.complaints.append(json.dumps(told["exceptionDetails"]))
            case "Runtime.consoleAPICalled" if told["type"] in ("error", "warning", "assert"):
                self.complaints.append(json.dumps(told["args"]))
            case "Log.entryAdded" if told["entry"]["level"] in ("error", "warning"):
                self.complaints.append(told["entry"]["text"])
