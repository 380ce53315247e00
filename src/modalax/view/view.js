"use strict";
(function () {
  const byId = (id) => document.getElementById(id);
  const dark = window.matchMedia("(prefers-color-scheme: dark)");
  const config = {responsive: true, displaylogo: false, showSendToCloud: false, plotlyServerURL: "", modeBarButtonsToRemove: [
    "select2d", "lasso2d", "zoom2d", "pan2d", "zoomIn2d", "zoomOut2d", "autoScale2d"]};
  // Colour, symbol and size of each kind of pole, from new to stable in everything.
  const KINDS = [["#8c8c8c", "circle", 4], ["#2e8bcc", "x-thin-open", 6], ["#cc79a7", "diamond", 6], ["#009e73", "circle", 6]];
  const ORANGE = "#d55e00";
  let opening = null, now = null, shown = null, drawn = "", chosen = 1, channel = "sum", busy = false, dirty = false;
  let shape = null, mostMarks = 0;

  function colours() {
    const style = getComputedStyle(document.documentElement), of = (name) => style.getPropertyValue(name).trim();
    return {ground: of("--ground"), ink: of("--ink"), quiet: of("--quiet"), line: of("--line")};
  }

  function numbers(part) {
    const bytes = Uint8Array.from(atob(part.bdata), (c) => c.charCodeAt(0));
    return {f4: Float32Array, f8: Float64Array, i4: Int32Array}[part.dtype] === undefined
      ? [] : Array.from(new {f4: Float32Array, f8: Float64Array, i4: Int32Array}[part.dtype](bytes.buffer));
  }

  function escaped(text) {
    return text.replace(/&/g, "&amp;").replace(/</g, "&lt;").replace(/>/g, "&gt;");
  }

  function say(text, bad) {
    byId("state").textContent = text;
    byId("state").classList.toggle("bad", Boolean(bad));
  }

  async function post(name, message) {
    if (window.modalaxAsk) return window.modalaxAsk(name, message);
    const answer = await fetch(name, {method: "POST", headers: {"Content-Type": "application/json"}, body: JSON.stringify(message || {})});
    const value = await answer.json();
    if (!answer.ok) throw new Error(value.error);
    return value;
  }

  // A step: sent, answered, drawn. While one is under way no other starts; a long one tells how far it is.
  async function step(name, message) {
    if (busy) return null;
    busy = true;
    document.body.classList.add("busy");
    const began = performance.now();
    const waiting = setInterval(async function () {
      try {
        const told = await post("progress");
        if (busy) say((told.step || "working") + " ... " + Math.round((performance.now() - began) / 1000) + " s");
      } catch (error) { /* the step itself tells of it */ }
    }, 1000);
    try {
      const value = await post(name, Object.assign({channel: channel, mode: chosen}, message));
      if (name === "save") {
        dirty = false;
        say("saved: " + value.saved);
        return value;
      }
      if (!["now"].includes(name)) dirty = true;
      await show(value);
      say("");
      document.documentElement.dataset.took = Math.round(performance.now() - began);
      return value;
    } catch (error) {
      say(error.message, true);
      return null;
    } finally {
      clearInterval(waiting);
      busy = false;
      document.body.classList.remove("busy");
      buttons();
    }
  }

  async function show(value) {
    now = value;
    if (now.diagram !== drawn) {
      shown = await post("diagram");
      drawn = now.diagram;
      await drawDiagram();
      fields();
    }
    chosen = Math.min(Math.max(chosen, 1), Math.max(now.modes.length, 1));
    table();
    shape.show(now.shape ? numbers(now.shape.u) : null, now.shape && now.shape.other ? numbers(now.shape.other) : null);
    const mode = now.modes[chosen - 1];
    byId("shapeName").textContent = mode ? "of mode " + chosen + ", " + mode.f.toFixed(3) + " Hz" + (mode.name ? ", " + mode.name : "") : "";
    byId("unexplained").textContent = "unexplained: " + (100 * now.unexplained).toPrecision(3) + " % of the FRFs' sum of squares";
    await Promise.all([marks(), drawCurve(), drawMac(), drawCross()]);
  }

  function buttons() {
    if (!now) return;
    byId("undo").disabled = !now.undo;
    byId("redo").disabled = !now.redo;
    byId("refine").disabled = byId("clear").disabled = !now.modes.length;
  }

  function fields() {
    const set = {low: now.band[0], high: now.band[1], order: now.order};
    for (const name of ["low", "high"]) {
      const slider = byId(name + "Slider");
      slider.min = opening.band[0];
      slider.max = opening.band[1];
      slider.step = (opening.band[1] - opening.band[0]) / 1000;
      slider.value = set[name];
      byId(name).value = Number(set[name].toPrecision(8));
    }
    byId("orderSlider").max = Math.max(3 * shown.orders[1], 20);
    byId("orderSlider").value = byId("order").value = set.order;
  }

  function axis(more) {
    const c = colours();
    return Object.assign({
      showline: true, ticks: "outside", zeroline: false, gridcolor: c.line, linecolor: c.ink, tickcolor: c.ink, exponentformat: "power", automargin: true,
    }, more);
  }

  // Ticks at powers of ten, or at 1, 2 and 5 times them where there are few.
  function logarithmic(parts) {
    const all = parts.flatMap(numbers).filter((v) => v > 0);
    const decades = Math.log10(Math.max(...all) / Math.min(...all));
    return {type: "log", dtick: decades > 1.7 ? 1 : "D2"};
  }

  function layout(more) {
    const c = colours();
    return Object.assign({
      template: "none", font: {family: "system-ui, sans-serif", size: 12, color: c.ink}, paper_bgcolor: c.ground, plot_bgcolor: c.ground,
      margin: {l: 62, r: 20, t: 34, b: 44}, hovermode: "closest", dragmode: "zoom", hoverlabel: {namelength: -1},
      legend: {orientation: "h", y: 1.01, yanchor: "bottom", x: 0, bgcolor: "rgba(0,0,0,0)"},
    }, more);
  }

  function drawDiagram() {
    const div = byId("diagram"), c = colours();
    const curve = (y, name, colour, first) => ({
      x: shown.freq, y: y, name: name, mode: "lines", line: {color: colour, width: 1.2}, yaxis: "y2", hoverinfo: "skip",
      showlegend: first, legendgroup: name,
    });
    const data = [curve(shown.sum, "sum FRF", c.quiet, true)];
    shown.cmif.forEach((y, k) => data.push(curve(y, "√CMIF", "#b89b4a", k === 0)));
    shown.poles.forEach(function (kind, k) {
      const [colour, symbol, size] = KINDS[k];
      data.push({
        x: kind.x, y: kind.y, customdata: kind.zeta, name: kind.name, mode: "markers", meta: "poles",
        marker: {color: colour, symbol: symbol, size: size, line: {color: colour, width: symbol.startsWith("x") ? 1.2 : 0}},
        hovertemplate: "%{x:.4f} Hz, %{customdata:.3f} %<br>order %{y}<extra>" + kind.name + "</extra>",
      });
    });
    const [first, last] = shown.orders;
    const figure = layout({
      xaxis: axis({title: {text: "Frequency [Hz]"}, range: [now.band[0], now.band[1]]}),
      yaxis: axis({title: {text: "Model order"}, range: [first - 1.5, last + 1.5], tickformat: "d"}),
      yaxis2: axis({title: {text: shown.cmif.length ? opening.sumLabel.replace("Sum FRF", "Sum FRF, √CMIF") : opening.sumLabel},
                    overlaying: "y", side: "right", showgrid: false, ...logarithmic([shown.sum].concat(shown.cmif))}),
      hoverdistance: 25,
    });
    return Plotly.newPlot(div, data, figure, config).then(function () {
      div.on("plotly_click", function (event) {
        const point = event.points.find((p) => p.data.meta === "poles");
        if (point) step("pick", {order: point.y, f: point.x});
      });
    });
  }

  function marks() {
    if (!shown) return null;
    // Numbers of close modes stand in two or three rows, so that none lies on another.
    const close = 0.018 * (now.band[1] - now.band[0]), rows = [];
    now.modes.forEach((m, k) => rows.push(k && m.f - now.modes[k - 1].f < close ? (rows[k - 1] + 1) % 3 : 0));
    const lines = now.modes.map((m, k) => ({
      type: "line", x0: m.f, x1: m.f, y0: 0, y1: 1 - 0.045 * rows[k], yref: "paper", layer: "below",
      line: {color: ORANGE, width: k + 1 === chosen ? 2.2 : 1, dash: k + 1 === chosen ? "solid" : "dash"},
      label: {text: "\u00a0" + (k + 1), textposition: "end", textangle: 0, xanchor: "left", yanchor: "top", padding: 1, font: {color: ORANGE, size: 11}},
    }));
    // The pole itself of each pick, where it is one of the diagram's.
    const rings = now.modes.filter((m) => m.order !== null).map((m) => ({
      type: "circle", xsizemode: "pixel", ysizemode: "pixel", xanchor: m.f, yanchor: m.order, x0: -7, x1: 7, y0: -7, y1: 7,
      line: {color: ORANGE, width: 2},
    }));
    // Shapes alone are drawn without the plot, which then still counts on those there were.
    const all = lines.concat(rings);
    while (all.length < mostMarks) all.push({type: "line", visible: false});
    mostMarks = all.length;
    return Plotly.relayout(byId("diagram"), {shapes: all});
  }

  function drawCurve() {
    const c = colours(), both = now.curve;
    const line = (y, name, colour, more) => Object.assign({x: shown.freq, y: y, name: name, mode: "lines", line: {color: colour, width: 1.4}}, more);
    const data = [
      line(both.magnitude[0], "measured", c.ink),
      line(both.magnitude[1], "synthesised", ORANGE),
    ];
    const range = byId("diagram")._fullLayout.xaxis.range.slice();
    const figure = layout({
      xaxis: axis({title: {text: "Frequency [Hz]"}, range: range, anchor: both.phase ? "y2" : "y"}),
      yaxis: axis({title: {text: channel === "sum" ? opening.sumLabel : opening.label}, domain: both.phase ? [0.36, 1] : [0, 1], ...logarithmic([both.magnitude[0]])}),
    });
    if (both.phase) {
      data.push(line(both.phase[0], "measured", c.ink, {yaxis: "y2", mode: "markers", marker: {size: 2.5, color: c.ink}, showlegend: false}));
      data.push(line(both.phase[1], "synthesised", ORANGE, {yaxis: "y2", showlegend: false}));
      figure.yaxis2 = axis({title: {text: "Phase [°]"}, domain: [0, 0.28], tickvals: [-180, -90, 0, 90, 180], range: [-190, 190]});
    }
    return Plotly.react(byId("curve"), data, figure, config);
  }

  function heat(div, z, x, y, xTitle) {
    const few = x.length * y.length <= 170;
    const trace = {
      type: "heatmap", z: z, x: x, y: y, zmin: 0, zmax: 1, colorscale: "Blues", reversescale: true, xgap: 1, ygap: 1,
      texttemplate: few ? "%{z:.2f}" : "", textfont: {size: 10}, hovertemplate: "%{y} and %{x}: %{z:.3f}<extra></extra>",
      colorbar: {title: {text: "MAC [-]", side: "right"}, thickness: 10, tickvals: [0, 0.5, 1]},
    };
    trace.colorscale = [[0, "#f3f7fb"], [0.5, "#6baed6"], [1, "#08306b"]];
    trace.reversescale = false;
    const figure = layout({
      margin: {l: 46, r: 10, t: 10, b: 40}, xaxis: axis({title: {text: xTitle}, type: "category", showgrid: false, tickangle: x.length > 8 ? -60 : 0}),
      yaxis: axis({type: "category", autorange: "reversed", showgrid: false}),
    });
    return Plotly.react(div, [trace], figure, Object.assign({}, config, {displayModeBar: false}));
  }

  function drawMac() {
    const names = now.modes.map((m, k) => String(k + 1));
    return heat(byId("mac"), now.mac, names, names, "Mode");
  }

  function drawCross() {
    byId("besidePart").hidden = !opening.beside;
    byId("cross").hidden = !now.beside || now.beside.error !== undefined;
    if (!now.beside) return null;
    if (now.beside.error !== undefined) {
      byId("besideHint").textContent = now.beside.error;
      return null;
    }
    const columns = now.beside.f.map((f, k) => (k + 1) + ": " + f.toPrecision(5) + " Hz");
    byId("besideHint").textContent = now.beside.common + " of " + now.beside.of + " DoFs are common; partners: " +
      (now.beside.pairs.map((p, k) => p < 0 ? null : (k + 1) + "–" + (p + 1)).filter(Boolean).join(", ") || "none") +
      ". The partner of a mode is drawn dashed over its shape.";
    return heat(byId("cross"), now.beside.mac, columns, now.modes.map((m, k) => String(k + 1)), opening.beside);
  }

  function value(number, std, unit, digits) {
    if (std === null) return (number * unit).toFixed(digits);
    const places = Math.min(Math.max(1 - Math.floor(Math.log10(std * unit)), 0), 8);
    return (number * unit).toFixed(places) + " ± " + (std * unit).toFixed(places);
  }

  function table() {
    const body = byId("modes").tBodies[0];
    body.replaceChildren(...now.modes.map(function (m, k) {
      const row = document.createElement("tr");
      row.classList.toggle("chosen", k + 1 === chosen);
      const cell = (text) => { const td = document.createElement("td"); td.textContent = text; row.append(td); return td; };
      cell(k + 1);
      const name = document.createElement("input");
      name.value = m.name;
      name.setAttribute("aria-label", "Name of mode " + (k + 1));
      name.addEventListener("change", () => step("name", {number: k + 1, text: name.value}));
      name.addEventListener("click", (event) => event.stopPropagation());
      cell("").append(name);
      cell(value(m.f, m.fStd, 1, 3));
      cell(value(m.zeta, m.zetaStd, 100, 3));
      cell(m.mpc === null ? "" : m.mpc.toFixed(3));
      cell(m.order === null ? (now.refined ? "refined" : "-") : m.order);
      const drop = document.createElement("button");
      drop.type = "button";
      drop.textContent = "×";
      drop.title = "Drop";
      drop.setAttribute("aria-label", "Drop mode " + (k + 1));
      drop.addEventListener("click", (event) => { event.stopPropagation(); step("drop", {number: k + 1}); });
      cell("").append(drop);
      row.addEventListener("click", () => choose(k + 1));
      return row;
    }));
  }

  function choose(number) {
    chosen = number;
    step("now");
  }

  function listChannels() {
    const option = (text, value) => { const o = document.createElement("option"); o.textContent = text; o.value = value; return o; };
    byId("output").replaceChildren(option("sum of all", "sum"), ...opening.outputs.map((n, k) => option(n, String(k))));
    byId("input").replaceChildren(...opening.inputs.map((n, k) => option(n, String(k))));
    byId("inputLabel").hidden = true;
    const change = function () {
      const o = byId("output").value;
      byId("inputLabel").hidden = o === "sum";
      channel = o === "sum" ? "sum" : [Number(o), Number(byId("input").value)];
      step("now");
    };
    byId("output").addEventListener("change", change);
    byId("input").addEventListener("change", change);
  }

  function fileName() {
    const ending = {selection: "-selection.json", model: "-modes.npz", result: "-modes.json", report: "-modes.html"};
    byId("file").value = opening.stem + ending[byId("what").value];
  }

  async function findings() {
    let told = await post("findings");
    while (!told.ready) {
      await new Promise((done) => setTimeout(done, 700));
      told = await post("findings");
    }
    const place = byId("findings");
    const paragraph = (text) => { const p = document.createElement("p"); p.className = "hint"; p.textContent = text; return p; };
    place.replaceChildren(...told.about.map(paragraph));
    if (!told.findings.length) {
      if (!told.about.some((t) => t.startsWith("the check could not"))) place.append(paragraph("Nothing wrong was found."));
      return;
    }
    const list = document.createElement("dl");
    for (const f of told.findings) {
      const term = document.createElement("dt"), text = document.createElement("dd");
      term.textContent = f.what.replace(/_/g, " ") + ": " + (f.where.join(", ") || "everywhere") + " (sure " + f.sure.toFixed(2) + ")";
      text.textContent = f.evidence + ". " + f.advice + ".";
      list.append(term, text);
    }
    place.append(list);
  }

  function wire() {
    for (const name of ["undo", "redo", "choose", "clear", "refine"]) byId(name).addEventListener("click", () => step(name));
    for (const name of ["low", "high", "order"]) {
      byId(name + "Slider").addEventListener("input", function () { byId(name).value = Number(Number(byId(name + "Slider").value).toPrecision(6)); });
      byId(name + "Slider").addEventListener("change", () => byId("look").requestSubmit());
    }
    byId("look").addEventListener("submit", function (event) {
      event.preventDefault();
      const band = [Number(byId("low").value), Number(byId("high").value)];
      const same = band.every((v, k) => Math.abs(v - Number(now.band[k].toPrecision(8))) < 1e-9 * Math.abs(v));
      step("look", {band: same ? null : band, order: Number(byId("order").value)});
    });
    byId("zoomed").addEventListener("click", function () {
      const range = byId("diagram")._fullLayout.xaxis.range;
      byId("low").value = Math.max(range[0], opening.band[0]).toPrecision(7);
      byId("high").value = Math.min(range[1], opening.band[1]).toPrecision(7);
      byId("look").requestSubmit();
    });
    byId("at").addEventListener("submit", function (event) {
      event.preventDefault();
      step("pick", {order: shown.orders[1], f: Number(byId("atHz").value)});
    });
    byId("play").addEventListener("click", function () {
      if (shape.playing()) shape.still(); else shape.play(true);
      byId("play").textContent = shape.playing() ? "Stop" : "Move";
    });
    byId("what").addEventListener("change", fileName);
    byId("save").addEventListener("submit", function (event) {
      event.preventDefault();
      step("save", {what: byId("what").value, name: byId("file").value, replace: byId("replace").checked});
    });
    document.addEventListener("keydown", function (event) {
      if (event.target.tagName === "INPUT" || !(event.ctrlKey || event.metaKey)) return;
      if (event.key === "z") { event.preventDefault(); step("undo"); }
      if (event.key === "y") { event.preventDefault(); step("redo"); }
    });
    window.addEventListener("beforeunload", function (event) { if (dirty) event.preventDefault(); });
    dark.addEventListener("change", function () { drawn = ""; show(now); });
  }

  async function start() {
    try {
      opening = await post("opening");
      byId("title").textContent = "Modes of " + opening.name;
      document.title = opening.name + ", modalax view";
      byId("folder").textContent = opening.folder;
      byId("besideName").textContent = opening.beside || "";
      listChannels();
      fileName();
      shape = ModalShape(byId("shape"), opening, colours);
      if (!opening.placed) byId("shapeHint").textContent = "DoFs in their order: there is no geometry. " + byId("shapeHint").textContent;
      wire();
      if (!(await step("now"))) return;
      dirty = false;
      const still = window.matchMedia("(prefers-reduced-motion: reduce)").matches;
      if (!still) shape.play(true);
      byId("play").textContent = still ? "Move" : "Stop";
      document.documentElement.dataset.ready = "yes";
      byId("diagram").on("plotly_relayout", function (change) {
        const range = change["xaxis.range[0]"] !== undefined || change["xaxis.autorange"];
        if (range) Plotly.relayout(byId("curve"), {"xaxis.range": byId("diagram")._fullLayout.xaxis.range.slice()});
      });
      await findings();
      document.documentElement.dataset.checked = "yes";
    } catch (error) {
      say("the page has lost its program: " + error.message, true);
    }
  }
  start();
})();
