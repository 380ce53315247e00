"""The page in a notebook: what its messages do to the session, and a person's steps in a real browser."""

import base64
import gzip
import json
import threading
from contextlib import contextmanager
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path

import numpy as np
import pytest

from modalax.model.examples import five_dof
from modalax.view import Widget
from modalax.view.steps import HERE

pytest.importorskip("anywidget")


class Kernel(Widget):
    """A widget of which it is kept what it sends to the page."""

    def __init__(self, session, **options):
        super().__init__(session, **options)
        self.sent = []
        self.frame.send = lambda content, buffers=None: self.sent.append((content, buffers or []))

    def ask(self, name, message=None, number=":1"):
        """What the page is answered, through the way that messages come in a kernel."""
        del self.sent[:]
        self.frame._handle_custom_msg({"number": number, "name": name, "message": message or {}}, [])
        (answer,) = [content for content, _ in self.sent if "number" in content]
        assert answer["number"] == number
        return answer.get("value", answer.get("error"))


def test_picks_drops_and_saves_reach_the_session_through_the_kernel_alone(session, tmp_path):
    widget = Kernel(session, name="five.npz", folder=tmp_path)
    assert widget.ask("opening")["name"] == "five.npz"
    told = widget.ask("drop", {"number": 2})
    assert len(told["modes"]) == 4 == len(session.state.picks) and widget.unsaved
    told = widget.ask("pick", {"order": 14, "f": 33.9})
    assert [m["f"] for m in told["modes"]] == [p.frequency_hz for p in session.state.picks] and len(told["modes"]) == 5
    assert widget.ask("save", {"what": "selection", "name": "picks.json"}) == {"saved": str(tmp_path / "picks.json")}
    kept = json.loads((tmp_path / "picks.json").read_text())["modes"]
    assert len(kept) == 5 and not widget.unsaved
    widget.ask("undo")
    assert len(session.state.picks) == 4 and session.model().poles.shape == (4,)
    json.dumps(widget.sent, allow_nan=False)


def test_what_cannot_be_done_is_told(session, monkeypatch):
    widget = Kernel(session)
    assert "there is no mode 9" in widget.ask("drop", {"number": 9})
    assert "there is no step 'fly'" in widget.ask("fly")
    widget.frame._handle_custom_msg({"number": ":2", "name": "now", "message": [1]}, [])
    assert widget.sent[-1][0] == {"number": ":2", "error": "a message is an object"}
    monkeypatch.setattr(widget.answers, "now", lambda *_: 1 / 0)
    assert widget.ask("now") == "ZeroDivisionError: division by zero"


def test_a_long_step_tells_how_far_it_is(session):
    widget = Kernel(session)
    widget.ask("refine")
    assert any(content.get("progress") for content, _ in widget.sent)


def test_the_page_holds_all_its_files_and_passes_a_notebook_server(session):
    """A server of notebooks drops what goes above a million bytes a second, over three seconds."""
    widget = Kernel(session)
    widget.frame._handle_custom_msg({"number": "a:", "name": "page"}, [])
    ((content, (packed,)),) = widget.sent
    page = gzip.decompress(packed).decode()
    assert content == {"number": "a:"} and len(packed) < 2e6
    assert (
        'src="' not in page.split("<body>")[0] and "modalaxAsk" in page and "ModalShape" in page and "--ground" in page
    )
    assert page.count("</script>") == 4


def test_a_cell_shows_it(session):
    data, _ = Kernel(session, name="five.npz")._repr_mimebundle_()
    assert "application/vnd.jupyter.widget-view+json" in data
    assert data["text/plain"] == "modalax view of five.npz: 5 modes (shown where a kernel runs)"


def test_a_missing_package_is_named(session, monkeypatch):
    monkeypatch.setitem(__import__("sys").modules, "anywidget", None)
    with pytest.raises(ImportError, match=r"pip install 'modalax\[notebook\]'"):
        Widget(session)


PROBE = Path(__file__).with_name("frame_probe.js").read_text()
NOTEBOOK = """<!DOCTYPE html><title>notebook</title><link rel="icon" href="data:,"><div id="cell"></div>
<img src="seen" alt=""><script type="module">
import widget from "./widget.js";
const heard = [];
const bytes = (text) => new DataView(Uint8Array.from(atob(text), (c) => c.charCodeAt(0)).buffer);
const model = {
  get: (name) => ({height: 800})[name],
  on: (name, hear) => heard.push(hear),
  off: () => null,
  send: async function (content) {
    const answer = await fetch("message", {method: "POST", body: JSON.stringify(content)});
    for (const [told, buffers] of await answer.json()) heard.forEach((hear) => hear(told, buffers.map(bytes)));
  },
};
widget.render({model: model, el: document.getElementById("cell")});
</script>"""


class Probed(Kernel):
    """A widget whose page carries the probe, which sends what it saw."""

    def __init__(self, session, **options):
        super().__init__(session, **options)
        self.seen, self.done = {}, threading.Event()

    def page(self):
        return super().page().replace("</body>", f"<script>{PROBE}</script></body>")

    def answer(self, name, asked):
        if name == "seen":
            self.seen = asked
            self.done.set()
            return {}
        return super().answer(name, asked)


@contextmanager
def notebook(widget):
    """Address of a page that shows the widget as a notebook does: its front end here, its messages to the kernel."""

    class Handler(BaseHTTPRequestHandler):
        def do_GET(self):
            if self.path == "/seen":  # the page counts as loading, and is waited for, until the probe is done
                widget.done.wait(60)
            front = self.path == "/widget.js"
            text = (HERE / "widget.js").read_text() if front else NOTEBOOK
            self.give(text.encode(), "text/javascript" if front else "text/html")

        def do_POST(self):
            asked = json.loads(self.rfile.read(int(self.headers["Content-Length"])))
            with lock:  # a kernel answers one message after the other
                del widget.sent[:]
                widget.frame._handle_custom_msg(asked, [])
                told = [[c, [base64.b64encode(b).decode() for b in buffers]] for c, buffers in widget.sent]
            self.give(json.dumps(told).encode(), "application/json")

        def give(self, body, kind):
            self.send_response(200)
            self.send_header("Content-Type", kind)
            self.send_header("Content-Length", str(len(body)))
            self.end_headers()
            self.wfile.write(body)

        def log_message(self, format, *args):
            pass

    lock = threading.Lock()
    server = ThreadingHTTPServer(("127.0.0.1", 0), Handler)
    threading.Thread(target=server.serve_forever, args=(0.1,), daemon=True).start()
    yield f"http://127.0.0.1:{server.server_port}/"
    server.shutdown()
    server.server_close()


def test_a_person_picks_drops_refines_and_saves_in_a_notebook(session, chromium, findings, tmp_path):
    widget = Probed(session, name="<five>.npz", folder=tmp_path, findings=lambda: findings)
    with notebook(widget) as address:
        _, console = chromium(address, "--window-size=1400,1000", "--dump-dom")
    assert console == []
    seen = widget.seen
    assert seen["errors"] == [] and seen["title"] == "Modes of <five>.npz" and seen["plots"] == [True] * 3
    assert [seen[k] for k in ("opened", "dropped", "picked")] == [5, 4, 5]
    assert "±" in seen["refined"] and session.state.refined is not None
    path = tmp_path / "picks.json"
    assert seen["saved"] == f"saved: {path}" and "exists already" in seen["again"]
    kept = [mode["frequency_hz"] for mode in json.loads(path.read_text())["modes"]]
    np.testing.assert_allclose(kept, five_dof().modal().frequency_hz, rtol=2e-3)
    assert "a <line> at 50 Hz" in seen["findings"]
    assert seen["outside"] == "closed"  # nothing in the page can reach the notebook
