"""A headless Chromium over its debugging pipe: opens a file and says what went wrong on it."""

import base64
import json
import os
import shutil
import subprocess
import tempfile
import time
from pathlib import Path

CHROMIUM = next((c for c in ("chromium", "chromium-browser", "google-chrome") if shutil.which(c)), None)
_FLAGS = (
    "--headless --no-sandbox --disable-gpu --disable-quic --no-first-run --disable-background-networking "
    "--disable-component-update --disable-sync --disable-dev-shm-usage --hide-scrollbars "
    "--remote-debugging-pipe"
)
_STATE = """(() => ({
  overflow: document.documentElement.scrollWidth - document.documentElement.clientWidth,
  images: [...document.images].map(i => i.complete && i.naturalWidth > 0),
  videos: [...document.querySelectorAll('video')].map(v => v.readyState > 0 && v.videoWidth > 0 && !v.error),
  height: document.documentElement.scrollHeight,
  text: document.body.innerText,
}))()"""


class Browser:
    """One Chromium with an empty profile; a context manager."""

    def __enter__(self):
        self._profile = tempfile.mkdtemp()
        to_child, self._write = os.pipe()
        self._read, from_child = os.pipe()
        arguments = [CHROMIUM, *_FLAGS.split(), f"--user-data-dir={self._profile}", "about:blank"]
        launch = f'exec "$@" 3<&{to_child} 4>&{from_child}'
        self._process = subprocess.Popen(
            ["bash", "-c", launch, "bash", *arguments],
            pass_fds=(to_child, from_child),
            stdin=subprocess.DEVNULL,
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
        )
        os.close(to_child)
        os.close(from_child)
        self._buffer, self._count, self.events = b"", 0, []
        target = self._ask("Target.createTarget", url="about:blank")["targetId"]
        self._session = self._ask("Target.attachToTarget", targetId=target, flatten=True)["sessionId"]
        for domain in ("Page", "Runtime", "Log", "Network"):
            self._ask(f"{domain}.enable")
        return self

    def __exit__(self, *_):
        os.close(self._write)
        self._process.terminate()
        self._process.wait(20)
        os.close(self._read)
        shutil.rmtree(self._profile, ignore_errors=True)

    def open(self, path: Path, width: int, height: int = 900) -> dict:
        """Loads a file in a window of a size; returns the page's state, console errors and requests."""
        self.events.clear()
        self._ask(
            "Emulation.setDeviceMetricsOverride",
            width=width,
            height=height,
            deviceScaleFactor=1,
            mobile=width < 600,
        )
        self._ask("Page.navigate", url=path.absolute().as_uri())
        deadline = time.monotonic() + 60
        while not any(e["method"] == "Page.loadEventFired" for e in self.events):
            self._event(deadline)
        state = self._value(_STATE)
        while not all(state["videos"]) and time.monotonic() < deadline:
            time.sleep(0.1)
            state = self._value(_STATE)
        return self.state()

    def state(self) -> dict:
        """The page's state, console errors and requests."""
        return self._value(_STATE) | {"errors": self._errors(), "requests": self._requests()}

    def wait(self, condition: str, seconds: float = 60.0) -> bool:
        """Waits until a JavaScript expression is true; says whether it became so."""
        deadline = time.monotonic() + seconds
        while not (met := self._value(condition)) and time.monotonic() < deadline:
            time.sleep(0.2)
        return bool(met)

    def screenshot(self, path: Path) -> None:
        """Saves the whole page as PNG."""
        data = self._ask("Page.captureScreenshot", captureBeyondViewport=True)["data"]
        path.write_bytes(base64.b64decode(data))

    def _errors(self):
        bad = ("Runtime.exceptionThrown", "Log.entryAdded")
        said = [e["params"] for e in self.events if e["method"] in bad]
        called = [e["params"] for e in self.events if e["method"] == "Runtime.consoleAPICalled"]
        return said + [c for c in called if c["type"] in ("error", "warning", "assert")]

    def _requests(self):
        sent = [e["params"] for e in self.events if e["method"] == "Network.requestWillBeSent"]
        urls = [p["request"]["url"] for p in sent]
        return [u[:80] for u in urls if not u.startswith(("data:", "file:", "blob:"))]

    def _value(self, expression):
        """What an expression gives; None for undefined, as what is not drawn yet gives."""
        return self._ask("Runtime.evaluate", expression=expression, returnByValue=True)["result"].get("value")

    def _ask(self, method, **parameters):
        self._count += 1
        message = {"id": self._count, "method": method, "params": parameters}
        if getattr(self, "_session", None):
            message["sessionId"] = self._session
        os.write(self._write, json.dumps(message).encode() + b"\0")
        deadline = time.monotonic() + 60
        while True:
            reply = self._message(deadline)
            if reply.get("id") == self._count:
                assert "error" not in reply, reply
                return reply["result"]
            self.events.append(reply)

    def _event(self, deadline):
        self.events.append(self._message(deadline))

    def _message(self, deadline):
        while b"\0" not in self._buffer:
            assert time.monotonic() < deadline, "Chromium does not answer"
            data = os.read(self._read, 1 << 20)
            assert data, "Chromium is gone"
            self._buffer += data
        message, self._buffer = self._buffer.split(b"\0", 1)
        return json.loads(message)
