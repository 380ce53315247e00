"""The HTML report: one file, escaped, alive in a real browser without a network."""

import html as html_module
import json
import re
import shutil
import subprocess
from html.parser import HTMLParser
from types import SimpleNamespace

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from modalax.data.frf import FRF
from modalax.data.geometry import Geometry
from modalax.identify import PoleTable
from modalax.model.examples import five_dof
from modalax.model.modal import ModalModel
from modalax.show.report import Page, Plot, Section, Table, fit_report
from modalax.show.report.fit import mode_rows, remarks
from modalax.show.report.moving import shapes_on
from modalax.show.report.plots import (
    MOST_LINES,
    axis_of,
    bar_plot,
    comparison_plot,
    frf_plot,
    mac_plot,
    phase_line,
    residual_plot,
    shape_plot,
    stabilization_plot,
    thinned,
)

NASTY = "1<b>\"&'</script><script>window.broken=1</script><img src=x onerror=window.broken=1>"


@pytest.fixture(scope="module")
def fit():
    """What a fit gives, made by hand from the true modes, with names that try to break out."""
    truth = five_dof().modal()
    outputs = (NASTY, *"2345")
    model = ModalModel(truth.poles, truth.shapes, truth.participation, outputs=outputs, inputs=truth.inputs)
    frf = model.frf(jnp.linspace(20, 70, 501), inputs=["3", "2"]).add_noise(jax.random.key(1), 0.1)
    model = ModalModel(truth.poles, truth.shapes, truth.participation[:, [2, 1]], outputs=outputs, inputs=("3", "2"))
    rng = np.random.default_rng(0)
    orders = tuple(range(5, 31))
    poles = np.full((26, 30), -1 + 1j)
    poles[:, :5] = np.asarray(truth.poles)
    poles[:, 5:] = 2j * np.pi * rng.uniform(20, 70, (26, 25)) - 1
    valid = np.arange(30)[None] < np.array(orders)[:, None]
    stable = valid & (np.arange(30) < 5)
    modes = [
        {
            "frequency_hz": float(f), "frequency_std_hz": 0.01, "damping_ratio": float(z), "damping_ratio_std": None,
            "predicted_damping_bias": None, "mpc": 1.0, "shape": [],
        }
        for f, z in zip(truth.frequency_hz, truth.damping_ratio, strict=True)
    ]  # fmt: skip
    return SimpleNamespace(
        frf=frf,
        model=model,
        table=PoleTable(jnp.asarray(poles), jnp.asarray(valid), None, orders, "lscf"),
        stability=SimpleNamespace(frequency=stable, damping=stable, shape=stable),
        refined=None,
        inside=np.ones(5, bool),
        to_dict=lambda: {"modes": modes, "unexplained": 0.0123},
    )


@pytest.fixture(scope="module")
def report(fit):
    return fit_report(fit, title=f"Modes of {NASTY}")


class Reader(HTMLParser):
    """Tags, addresses and heading of a page, as a browser reads them."""

    def __init__(self, text: str):
        super().__init__()
        self.tags, self.addresses, self.heading, self._inside = [], [], "", False
        self.feed(text)

    def handle_starttag(self, tag, attrs):
        self.tags.append(tag)
        self.addresses += [value for name, value in attrs if name in ("src", "href", "action", "poster", "data")]
        assert not [name for name, _ in attrs if name.startswith("on")]
        self._inside = tag == "h1"

    def handle_data(self, data):
        if self._inside:
            self.heading += data

    def handle_endtag(self, tag):
        self._inside = False


def test_report_loads_nothing_and_is_small(report):
    page = Reader(report)
    assert page.addresses and all(a.startswith("#") or a == "data:," for a in page.addresses), page.addresses
    styles = "".join(re.findall(r"<style>(.*?)</style>", report, re.S))
    assert styles and "url(" not in styles and "@import" not in styles
    assert len(report.encode()) < 7e6  # plotly itself is 4.6 to 5 MB


def test_names_are_escaped(report):
    page = Reader(report)
    assert page.heading == f"Modes of {NASTY}"
    assert not {"img", "b"} & set(page.tags)
    data = re.findall(r'<script type="application/json"[^>]*>(.*?)</script>', report, re.S)
    assert len(data) == 5 and page.tags.count("script") == 5 + 2
    for text in data:
        assert "<" not in text and json.loads(text)


def test_numbers_of_the_table_are_those_of_the_fit(report):
    assert "26.060 ± 0.010" in report and "62.600 ± 0.010" in report
    assert "1.23 %" in report


def test_a_page_without_plotly_says_what_to_install(monkeypatch):
    import sys

    monkeypatch.setitem(sys.modules, "plotly.offline", None)
    with pytest.raises(ImportError, match=r"modalax\[report\]"):
        Page("empty").html()


def test_very_many_lines_are_thinned_and_keep_their_peaks():
    structure = five_dof()
    freq = jnp.linspace(20, 70, 3 * MOST_LINES)
    frf = structure.frf(freq, outputs=["1"], inputs=["1"])
    which = thinned(frf)
    assert len(which) == MOST_LINES and (np.diff(which) > 0).all()
    size = np.abs(np.asarray(frf.H)[:, 0, 0])
    peaks = np.flatnonzero((size[1:-1] > size[:-2]) & (size[1:-1] > size[2:])) + 1
    assert len(peaks) >= 3 and set(peaks) <= set(which)
    assert "peaks kept" in frf_plot(frf, structure).caption


def test_large_measurements_stay_within_the_budget():
    rng = np.random.default_rng(0)
    structure = five_dof()
    frf = structure.frf(jnp.linspace(20, 70, 1601), inputs=["1"])
    wide = frf.replace(
        H=jnp.asarray(rng.normal(size=(1601, 200, 1)) + 1j), outputs=[f"o{k}" for k in range(200)], variance=1.0
    )
    plot = frf_plot(wide, wide)
    size = sum(len(figure.to_json()) for _, figure in plot.figures)
    assert size < 4e6 and f"of {200} channels" in plot.caption


def test_equispaced_axis_is_written_by_start_and_step():
    assert axis_of(np.linspace(20, 70, 501)) == {"x0": 20.0, "dx": pytest.approx(0.1)}
    np.testing.assert_allclose(axis_of(np.array([1.0, 2.0, 4.0]))["x"], [1, 2, 4])


PROBE = """
<script>
(async function () {
  const seen = {errors: []};
  const wait = (ms) => new Promise((done) => setTimeout(done, ms));
  const key = (el, k) => el.dispatchEvent(new KeyboardEvent("keydown", {key: k, bubbles: true, cancelable: true}));
  try {
    await wait(300);
    const plots = Array.from(document.querySelectorAll(".plot"));
    seen.plots = plots.map((p) => p.querySelectorAll(".main-svg").length > 0);
    const select = document.querySelector("select[data-for]");
    const div = document.getElementById(select.dataset.for);
    const first = div.calcdata[0][5].y;
    select.value = "1";
    select.dispatchEvent(new Event("change"));
    await wait(300);
    seen.chosen = div.calcdata[0][5].y !== first;
    const range = () => div._fullLayout.xaxis.range.slice();
    const width = () => range()[1] - range()[0];
    const all = range();
    key(div, "+"); await wait(200); seen.zoomed = width() / (all[1] - all[0]);
    const before = range()[0];
    key(div, "ArrowRight"); await wait(200); seen.moved = range()[0] - before;
    key(div, "0"); await wait(300); seen.reset = Math.abs(width() / (all[1] - all[0]) - 1);
    Plotly.Fx.hover(div, [{curveNumber: 0, pointNumber: 10}], "xy");
    await wait(300);
    seen.hover = div.querySelectorAll(".hoverlayer .hovertext").length;
    seen.ink = div.querySelector(".ytick text").style.fill;
    seen.ground = getComputedStyle(document.documentElement).backgroundColor;
    seen.broken = window.broken === undefined ? 0 : 1;
    seen.overflow = document.documentElement.scrollWidth - document.documentElement.clientWidth;
    const ids = Array.from(document.querySelectorAll("[id]")).map((e) => e.id);
    seen.twice = ids.length - new Set(ids).size;
  } catch (error) { seen.errors.push(String(error)); }
  const out = document.createElement("pre");
  out.id = "seen";
  out.textContent = JSON.stringify(seen);
  document.body.append(out);
})();
</script>
"""


@pytest.fixture
def browse(chromium):
    """Gives a page's document after eight virtual seconds without a network, and its console's lines."""

    def browse(page, *flags):
        quiet = ("--virtual-time-budget=8000", "--window-size=1280,1000", "--host-resolver-rules=MAP * ~NOTFOUND")
        return chromium(page.as_uri(), *quiet, *flags)

    return browse


@pytest.mark.parametrize("dark", [False, pytest.param(True, marks=pytest.mark.slow)], ids=["light", "dark"])
def test_report_lives_in_a_browser(report, browse, tmp_path, dark):
    page = tmp_path / "report.html"
    page.write_text(report.replace("</body>", PROBE + "</body>"), encoding="utf-8")
    flags = ["--blink-settings=preferredColorScheme=0"] if dark else ["--blink-settings=preferredColorScheme=1"]
    dom, console = browse(page, "--dump-dom", *flags)
    assert console == []
    seen = json.loads(html_module.unescape(re.search(r'<pre id="seen">(.*?)</pre>', dom, re.S).group(1)))
    assert seen["errors"] == []
    assert seen["plots"] == [True] * 5
    assert seen["chosen"] and seen["hover"] >= 1
    assert seen["zoomed"] == pytest.approx(0.7, rel=1e-6)
    assert seen["moved"] > 0 and seen["reset"] < 1e-6
    assert seen["broken"] == 0 and seen["twice"] == 0
    assert seen["overflow"] <= 0  # nothing wider than the window
    grounds = {"light": "rgb(255, 255, 255)", "dark": "rgb(20, 24, 29)"}
    assert seen["ground"] == grounds["dark" if dark else "light"]
    assert seen["ink"].startswith("rgb(228" if dark else "rgb(28")


FRAMES = "<script>window.requestAnimationFrame = (f) => setTimeout(() => f(performance.now()), 50);</script>"
PAPER = """
<script>
(async function () {
  const wait = (ms) => new Promise((done) => setTimeout(done, ms)), seen = {};
  await wait(300);
  const canvas = document.querySelector("canvas.shape"), button = document.querySelector(".moving button");
  const first = canvas.toDataURL();
  await wait(400);
  seen.moved = canvas.toDataURL() !== first;
  button.click();
  const still = canvas.toDataURL();
  await wait(200);
  seen.stopped = canvas.toDataURL() === still && button.textContent === "Move";
  window.dispatchEvent(new Event("beforeprint"));
  await wait(300);
  seen.shapes = document.querySelectorAll(".paper canvas").length;
  const paper = () => Array.from(document.querySelectorAll(".copy")).filter((copy) => copy.querySelector(".main-svg"));
  const names = () => paper().map((copy) => copy.firstChild.textContent);
  seen.bars = names();
  const right = (element) => element.getBoundingClientRect().right;
  seen.wide = Math.max(...paper().map(right)) - right(document.body);
  window.dispatchEvent(new Event("afterprint"));
  seen.left = document.querySelectorAll(".paper canvas, .copy").length;
  const tick = document.querySelector("[data-tick]");
  tick.click();
  seen.told = document.querySelector("[data-count]").textContent;
  window.dispatchEvent(new Event("beforeprint"));
  await wait(300);
  seen.fewer = names();
  window.dispatchEvent(new Event("afterprint"));
  seen.shown = Array.from(document.querySelectorAll(".plot")).every((div) => div.clientHeight > 100);
  const out = document.createElement("pre");
  out.id = "seen";
  out.textContent = JSON.stringify(seen);
  document.body.append(out);
})();
</script>
"""


SCROLLED = """<script>
window.addEventListener("load", () => {
  const [wide, narrow] = document.querySelectorAll(".scroll");
  wide.scrollLeft = 1e6;
  const box = (element) => element.getBoundingClientRect(), text = box(wide.querySelector("caption span"));
  const told = {moved: wide.scrollLeft, left: text.left - box(wide).left, over: text.right - box(wide).right,
                share: box(narrow.querySelector("table")).width / box(narrow).width};
  document.body.append(
    Object.assign(document.createElement("pre"), {id: "scrolled", textContent: JSON.stringify(told)}));
});
</script>
"""
SHAPES_AND_TABLES = {}  # what one browser has told of a page that holds both


@pytest.fixture
def shapes_and_tables(browse, tmp_path):
    """What the two scripts above saw on a page of shapes and tables, and the console's lines."""
    if not SHAPES_AND_TABLES:
        names, said = [str(k) for k in range(5)], "what is said of it, in many words " * 20
        beam = Geometry(names, np.stack([np.linspace(0, 2, 5), np.zeros(5), np.zeros(5)], axis=1), [names])
        dofs, psi = [f"{k}:+Z" for k in names], np.array([[0, 1, 2, 1, 0], [0, 1, 0, -1, 0], [1.0, 1, 1, 1, 1]])
        parts = [shapes_on(beam, dofs, psi, [1, 2, 3]), shape_plot(psi, dofs, [1, 2, 3])]
        tables = [Table([f"column {k}" for k in range(n)], [["1234.5"] * n], said[: 20 * n]) for n in (80, 2)]
        page = tmp_path / "page.html"
        text = Page("S", sections=[Section("S", [], parts), Section("both", [], tables)]).html()
        text = text.replace("<head>", "<head>" + FRAMES)
        page.write_text(text.replace("</body>", PAPER + SCROLLED + "</body>"))
        dom, SHAPES_AND_TABLES["console"] = browse(page, "--dump-dom")
        for name in ("seen", "scrolled"):
            told = re.search(rf'<pre id="{name}">(.*?)</pre>', dom, re.S).group(1)
            SHAPES_AND_TABLES[name] = json.loads(html_module.unescape(told))
    return SHAPES_AND_TABLES


def test_shapes_move_on_screen_and_stand_side_by_side_on_paper(shapes_and_tables):
    assert shapes_and_tables["console"] == []
    seen = dict(shapes_and_tables["seen"])
    assert seen.pop("wide") <= 0.5  # pixels beyond the paper
    every = ["1: 1 Hz", "2: 2 Hz", "3: 3 Hz"]
    assert seen == {
        "moved": True, "stopped": True, "shapes": 3, "bars": every, "left": 0, "told": "2 of 3 on paper",
        "fewer": every[1:], "shown": True,
    }  # fmt: skip


def test_what_is_said_of_a_wide_table_stays_in_sight(shapes_and_tables):
    seen = shapes_and_tables["scrolled"]
    assert seen["moved"] > 1000 and abs(seen["left"]) < 10 and seen["over"] < 1
    assert seen["share"] < 0.5  # a narrow table stays narrow


def test_remarks_stand_in_a_table_of_their_own(fit):
    modes = fit.to_dict()["modes"]
    assert remarks(modes) == [] and "Bias" not in " ".join(mode_rows(modes).head)
    modes[1] |= {"flags": ["narrow", "weak"], "predicted_damping_bias": 0.001}
    (table,) = remarks(modes)
    assert table.rows == [["2", f"{modes[1]['frequency_hz']:.5g}", "narrow; weak"]]
    assert "Bias of damping [%]" in mode_rows(modes).head


def test_modal_masses_stand_in_the_table_where_a_drive_point_tells_them(fit):
    modes = [{**mode, "modal_mass_kg": None, "modal_mass_std_kg": None} for mode in fit.to_dict()["modes"]]
    assert "Modal mass [kg]" not in mode_rows(modes).head
    modes[0] |= {"modal_mass_kg": [2.5, 0.1], "modal_mass_std_kg": 0.01}
    modes[1] |= {"modal_mass_kg": [float("nan"), float("nan")]}
    table = mode_rows(modes)
    at = table.head.index("Modal mass [kg]")
    assert [row[at] for row in table.rows] == ["2.500 ± 0.010", "-", *["-"] * (len(modes) - 2)]
    assert "its largest component 1" in table.caption
    truth = np.ones(len(modes)), np.ones(len(modes))
    assert "Modal mass [kg]" not in mode_rows(modes, truth).head


def test_a_selected_mode_without_a_pole_is_explained(fit):
    plot = stabilization_plot(fit.table, fit.stability, fit.frf, [*fit.model.frequency_hz, 1234.5])
    assert "mode at 1234.5 Hz (dotted) has no pole" in plot.caption
    dashes = [shape.line.dash for shape in plot.figures[0][1].layout.shapes]
    assert dashes == ["dash"] * 5 + ["dot"]
    assert "dotted" not in stabilization_plot(fit.table, fit.stability, fit.frf, fit.model.frequency_hz).caption


def test_the_axes_of_the_diagram_say_what_they_show(fit):
    layout = stabilization_plot(fit.table, fit.stability, fit.frf, fit.model.frequency_hz).figures[0][1].layout
    assert layout.yaxis2.title.text.startswith("Sum FRF, √CMIF") and layout.yaxis2.ticks == "outside"
    assert layout.yaxis.tickformat == "d" and layout.yaxis2.overlaying == "y"


def test_a_phase_line_is_broken_where_it_passes_half_a_turn():
    turn = np.deg2rad([170, 175, -178, -170, 170, 100])
    np.testing.assert_allclose(phase_line(np.exp(1j * turn)), [170, 175, np.nan, -170, np.nan, 100], atol=1e-9)


def test_a_matrix_holds_its_numbers_where_they_can_be_read():
    for size, numbered in ((20, True), (21, False)):
        names = [str(k) for k in range(size)]
        trace = mac_plot(np.eye(size), names, names, "").figures[0][1].data[0]
        assert bool(trace.texttemplate) is numbered


def test_the_strongest_channels_stand_on_paper(fit):
    """Of five channels all; of more the six of the most energy, in their order on the page."""
    H = np.asarray(fit.frf.H)
    assert list(frf_plot(fit.frf.pick(inputs=["3"]), None).on_paper) == list(range(5))
    size = np.array([3, 9, 1, 8, 2, 7, 6, 5])
    names = [f"a{k}" for k in range(8)]
    many = FRF(fit.frf.freq, H[:, :1, :1] * size[:, None], form=fit.frf.form, outputs=names, inputs=["1"])
    assert list(frf_plot(many, None).on_paper) == [0, 1, 3, 5, 6, 7]


@pytest.mark.skipif(shutil.which("pdftotext") is None, reason="no pdftotext on this machine")
def test_no_head_of_a_table_is_parted_from_its_rows_on_paper(browse, tmp_path):
    """Tables that fit a page are whole; longer ones begin with some rows, and each page of them repeats the head."""
    sizes, page, paper = (25, 12, 45, 20, 31, 60), tmp_path / "tables.html", tmp_path / "tables.pdf"
    tables = [Table([f"head{n}", "x"], [[f"{n}row{r}", "1"] for r in range(n)], f"caption{n}") for n in sizes]
    sections = [Section(f"title{n}", [], [table]) for n, table in zip(sizes, tables, strict=True)]
    page.write_text(Page("Tables", sections=sections).html())
    browse(page, f"--print-to-pdf={paper}")
    text = subprocess.run(["pdftotext", "-layout", paper, "-"], capture_output=True, text=True, check=True).stdout
    on = lambda word: [k for k, t in enumerate(text.split("\f")) if re.search(rf"\b{word}\b", t)]
    for n in sizes:
        assert len(on(f"title{n}")) == 1
        start = on(f"title{n}")
        assert on(f"caption{n}") == on(f"{n}row0") == on(f"{n}row4") == start and start[0] in on(f"head{n}")
        pages = sorted({k for r in range(n) for k in on(f"{n}row{r}")})
        assert pages == on(f"head{n}") and (n > 30 or len(pages) == 1)


@pytest.mark.slow
def test_report_prints(report, browse, tmp_path):
    page, paper = tmp_path / "report.html", tmp_path / "report.pdf"
    page.write_text(report, encoding="utf-8")
    browse(page, f"--print-to-pdf={paper}")
    content = paper.read_bytes()
    assert content.startswith(b"%PDF")
    pages = len(re.findall(rb"/Type\s*/Page\b", content))
    assert 2 <= pages <= 8


def test_every_kind_of_plot_renders():
    rng = np.random.default_rng(0)
    r = rng.normal(size=(2, 3, 100)) + 1j * rng.normal(size=(2, 3, 100))
    freq, H = np.linspace(10, 20, 100), np.moveaxis(r, 2, 1)[..., None]
    parts = [
        residual_plot(freq, [("before", r[0]), ("after", r[1])], ["<a>", "b", "c"]),
        bar_plot(["<x>", "y"], [0.9, 0.1], "Probability [-]", "Candidates."),
        comparison_plot(freq, H, H * 1.1, None, "mobility", ["a", "b", "c"], ["<i>"], ["1 N", "2 N"]),
        Table(["a", "b"], [["<1>", "2"]], "caption"),
    ]
    text = Page("All", sections=[Section("One", ["<p>"], parts)]).html()
    assert "&lt;p&gt;" in text and "&lt;1&gt;" in text and text.count('class="plot"') == 3
    assert isinstance(parts[0], Plot) and "\\u0026lt;a\\u0026gt;" in text


def test_the_frf_that_the_simulation_misses_most_is_seen_first():
    rng = np.random.default_rng(1)
    H = rng.normal(size=(2, 50, 3, 1)) + 1j * rng.normal(size=(2, 50, 3, 1))
    simulated = H.copy()
    simulated[1, :, 2] *= -1  # the same magnitude
    plot = comparison_plot(np.linspace(1, 2, 50), H, simulated, H, "mobility", ["a", "b", "c"], ["d"], ["1 N", "2 N"])
    labels = [label for label, _ in plot.figures]
    assert labels[0] == "c from d, 2 N" and labels[1:3] == ["a from d, 1 N", "a from d, 2 N"] and len(labels) == 6
    assert [trace.yaxis for trace in plot.figures[0][1].data] == ["y", "y2"] * 3  # magnitude and phase
