"""The page's server: who may ask, what is answered, and a person's steps in a real browser."""

import html
import http.client
import json
import re
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from modalax.cli.view import wait
from modalax.data.datasets import uliege_plane
from modalax.files import save
from modalax.model.examples import five_dof
from modalax.model.indicators import mac
from modalax.model.mode_table import ModeTable
from modalax.view import Server, Session
from modalax.view.beside import Beside, read_beside


@pytest.fixture
def server(session, findings, tmp_path):
    made = Server(session, name="<five>.npz", folder=tmp_path, findings=lambda: findings)
    yield made
    made.close()


def ask(server, name, message=None, body=None, method="POST", token=None, headers=None):
    """Status and content of an answer."""
    host = server.listener.hosts[0]
    path = f"/{token or server.url.split('/')[3]}/{name}"
    connection = http.client.HTTPConnection(host, timeout=30)
    content = json.dumps(message or {}) if body is None else body
    connection.request(method, path, content if method == "POST" else None, {"Host": host, **(headers or {})})
    answer = connection.getresponse()
    text = answer.read()
    connection.close()
    return answer.status, json.loads(text) if method == "POST" and answer.status in (200, 422, 500) else text


def test_only_this_machine_with_the_token_is_answered(server):
    assert server.url.startswith("http://127.0.0.1:") and len(server.url.split("/")[3]) >= 40
    assert server.listener.server_address[0] == "127.0.0.1"
    assert ask(server, "", method="GET")[0] == 200
    for refused in (
        {"token": "x"}, {"token": server.url.split("/")[3][:-1]}, {"headers": {"Host": "elsewhere.example:80"}},
        {"headers": {"Origin": "http://elsewhere.example"}},
    ):  # fmt: skip
        assert ask(server, "", method="GET", **refused) == (403, b"refused")
        assert ask(server, "now", **refused) == (403, b"refused")
    assert ask(server, "now", headers={"Origin": f"http://{server.listener.hosts[1]}"})[0] == 200


def test_only_the_files_of_the_page_are_given(server):
    for name, words in [
        ("", b"<title>"),
        ("view.js", b"use strict"),
        ("view.css", b"--ground"),
        ("shape.js", b"ModalShape"),
    ]:
        assert words in ask(server, name, method="GET")[1]
    assert len(ask(server, "plotly.js", method="GET")[1]) > 1e6
    for name in ("view.html/..", "../session.py", "session.py", "%2e%2e/session.py", "x"):
        assert ask(server, name, method="GET")[0] == 404


def test_messages_that_cannot_be_understood_are_told(server):
    assert ask(server, "now", body="{")[0] == 422
    assert ask(server, "now", body="[]") == (422, {"error": "a message is an object"})
    assert ask(server, "now", body=" " * 200_000)[0] == 413
    assert "there is no step 'fly'" in ask(server, "fly")[1]["error"]
    assert "lacks a number" in ask(server, "pick", {"order": 3})[1]["error"]
    assert "the diagram has no order 3000" in ask(server, "pick", {"order": 3000, "f": 1})[1]["error"]
    status, told = ask(server, "drop", {"number": 9})
    assert status == 422 and told == {"error": "there is no mode 9; 5 are picked"}


def test_steps_are_answered_and_saved_once(server, tmp_path):
    opening = ask(server, "opening")[1]
    assert (
        opening["name"] == "<five>.npz" and opening["outputs"] == list("12345") and opening["folder"] == str(tmp_path)
    )
    told = ask(server, "drop", {"number": 2})[1]
    assert len(told["modes"]) == 4 and told["undo"] and server.unsaved
    told = ask(server, "look", {"band": [25, 65], "order": 12})[1]
    assert told["band"] == [25, 65] and told["order"] == 12
    name = {"what": "selection", "name": "picks.json"}
    assert ask(server, "save", name)[1] == {"saved": str(tmp_path / "picks.json")} and not server.unsaved
    assert "exists already" in ask(server, "save", name)[1]["error"]
    assert ask(server, "save", {**name, "replace": True})[0] == 200
    assert "plain file name" in ask(server, "save", {**name, "name": "../x.json"})[1]["error"]


def test_findings_come_aside(server):
    for _ in range(100):
        told = ask(server, "findings")[1]
        if told["ready"]:
            break
    assert told["findings"][0]["what"] == "hum" and told["about"] == ["two runs"]


def test_a_check_that_fails_is_told(session):
    def broken():
        raise RuntimeError("too short")

    server = Server(session, findings=broken)
    server._check(broken)
    assert ask(server, "findings")[1]["about"] == ["the check could not be done: too short"]
    server.close()


def test_an_end_tells_what_was_not_saved(capsys, monkeypatch):
    def stop(self):
        raise KeyboardInterrupt

    monkeypatch.setattr("threading.Event.wait", stop)
    closed = []
    picks = (SimpleNamespace(frequency_hz=18.8432),)
    wait(SimpleNamespace(
        close=lambda: closed.append(1), unsaved=True, session=SimpleNamespace(state=SimpleNamespace(picks=picks))
    ))  # fmt: skip
    assert closed and "not saved: 1 modes at 18.8432 Hz" in capsys.readouterr().err


PROBE = (Path(__file__).parent / "probe.js").read_bytes()


class Probed(Server):
    """A server whose page carries the probe."""

    def file(self, name):
        if name == "probe.js":
            return PROBE, "text/javascript"
        found = super().file(name)
        if name == "" and found is not None:
            found = found[0].replace(b"</body>", b'<script src="probe.js"></script></body>'), found[1]
        return found


def visited(chromium, server):
    """What the probe saw in a browser."""
    page, console = chromium(server.url, "--virtual-time-budget=20000", "--window-size=1400,1000", "--dump-dom")
    server.close()
    assert [line for line in console if "422" not in line] == []
    seen = json.loads(html.unescape(re.search(r'<pre id="seen">(.*?)</pre>', page, re.S).group(1)))
    assert seen["errors"] == []
    return seen


@pytest.mark.slow
@pytest.mark.measured
def test_the_aeroplane_is_corrected_and_saved_in_a_browser_beside_its_finite_elements(
    measured, chromium, findings, tmp_path
):
    plane = uliege_plane()
    session = Session(plane.frf, geometry=plane.geometry)
    modes = len(session.state.picks)
    # The file of the finite-element shapes has no frequencies; pairs are found by shape.
    elements = ModeTable.of(np.linspace(20, 170, 13), np.nan, plane.fe_shapes, plane.frf.inputs)
    beside = Beside("fe_modes.npz", elements)
    server = Probed(session, name="plane", folder=tmp_path, beside=beside, findings=lambda: findings)
    seen = visited(chromium, server)
    steps = ("opened", "dropped", "picked", "less", "undone")
    assert [seen[k] for k in steps] == [modes, modes - 1, modes, modes - 1, modes] and modes > 10
    assert len(seen["reloaded"]) == len(json.loads((tmp_path / "picks.json").read_text())["modes"]) == modes
    assert seen["beside"]["hint"].startswith("73 of 73 DoFs are common") and seen["overlaid"] > 50
    assert np.array(seen["beside"]["mac"]).max(axis=0)[:6].min() > 0.9  # the first six shapes match measured modes


@pytest.fixture
def heavier(tmp_path):
    """Matrices of the structure with half of its last mass once more on it: alike, and not the same."""
    truth = five_dof()
    save(truth.replace(M=truth.M.at[4, 4].multiply(1.5)), tmp_path / "heavier.npz")
    return read_beside(tmp_path / "heavier.npz")


def test_a_person_picks_drops_names_and_saves_in_a_browser_with_a_model_beside(
    session, chromium, findings, heavier, tmp_path
):
    server = Probed(session, name="<five>.npz", folder=tmp_path, beside=heavier, findings=lambda: findings)
    seen = visited(chromium, server)
    assert seen["plots"] == [True] * 3 and seen["title"] == "Modes of <five>.npz"
    assert [seen[k] for k in ("opened", "dropped", "picked", "less", "undone")] == [5, 4, 5, 4, 5]
    assert seen["phase"] == 4 and seen["name"] == "<i>bending</i>" == session.state.picks[0].name
    path = tmp_path / "picks.json"
    assert seen["saved"] == f"saved: {path}" and "exists already" in seen["again"]
    kept = json.loads(path.read_text())["modes"]
    np.testing.assert_allclose([m["frequency_hz"] for m in kept], five_dof().modal().frequency_hz, rtol=2e-3)
    assert "a <line> at 50 Hz" in seen["findings"] and seen["overflow"] <= 0 and seen["colours"] > 3
    # Nothing that is shown is offered to be sent elsewhere.
    assert set(seen["buttons"]) == {"Download plot as a PNG", "Reset axes"}
    beside = seen["beside"]
    assert beside["title"] == "heavier.npz" and beside["hint"].startswith("5 of 5 DoFs are common; partners: 1–1, 2–2")
    f, shapes = heavier.table.frequency_hz, heavier.table.shapes
    assert beside["names"] == [f"{k + 1}: {x:.5g} Hz" for k, x in enumerate(f)]
    np.testing.assert_allclose(beside["mac"], mac(five_dof().modal().shapes, shapes), atol=0.02)
    assert seen["overlaid"] > 20  # pixels of the partner's shape, dashed over the moving one
    assert seen["reloaded"] == ["<i>bending</i>", "", "", "", ""]
