"use strict";
(function () {
  const dark = window.matchMedia("(prefers-color-scheme: dark)");
  const config = {responsive: true, displaylogo: false, showSendToCloud: false, plotlyServerURL: "", modeBarButtonsToRemove: ["select2d", "lasso2d"]};
  const plots = Array.from(document.querySelectorAll(".plot"));
  let printing = false;

  function colours() {
    return dark.matches && !printing
      ? {ink: "#e4e8ec", line: "#39424d", ground: "#14181d"}
      : {ink: "#1c2128", line: "#d9dee3", ground: "#ffffff"};
  }

  // A copy of a figure in the colours of the page; the stored figure stays as it came.
  function themed(figure) {
    const c = colours();
    const layout = Object.assign({}, figure.layout, {
      paper_bgcolor: c.ground, plot_bgcolor: c.ground,
      font: Object.assign({}, figure.layout.font, {color: c.ink}),
      hoverlabel: {namelength: -1},
    });
    for (const key of Object.keys(layout)) {
      if (/^[xy]axis\d*$/.test(key)) {
        layout[key] = Object.assign({}, layout[key], {gridcolor: c.line, zerolinecolor: c.line, linecolor: c.ink});
      }
    }
    const data = figure.data.map(function (trace) {
      // The numbers of a large matrix are set smaller on paper, which is narrower.
      if (printing && trace.texttemplate && trace.x && trace.x.length > 12) return Object.assign({}, trace, {textfont: {size: 7.5}});
      if (trace.meta !== "ink") return trace;
      const copy = Object.assign({}, trace);
      if (trace.line) copy.line = Object.assign({}, trace.line, {color: c.ink});
      if (trace.marker) copy.marker = Object.assign({}, trace.marker, {color: c.ink});
      return copy;
    });
    return {data: data, layout: layout};
  }

  function choice(div) {
    const select = document.querySelector('select[data-for="' + div.id + '"]');
    return div.choices[select ? Number(select.value) : 0].figure;
  }

  function draw(div) {
    const figure = themed(choice(div));
    return Plotly.react(div, figure.data, figure.layout, config);
  }

  // The range of every axis of one direction, moved by a part of its length and scaled about its middle.
  function view(div, letter, shift, scale) {
    const change = {};
    for (const key of Object.keys(div._fullLayout)) {
      if (!new RegExp("^" + letter + "axis\\d*$").test(key)) continue;
      const range = div._fullLayout[key].range;
      if (!range || typeof range[0] !== "number") continue;
      const middle = (range[0] + range[1]) / 2 + shift * (range[1] - range[0]);
      const half = (range[1] - range[0]) / 2 * scale;
      change[key + ".range"] = [middle - half, middle + half];
    }
    return Plotly.relayout(div, change);
  }

  function showAll(div) {
    const change = {};
    for (const key of Object.keys(div._fullLayout)) {
      if (/^[xy]axis\d*$/.test(key)) change[key + ".autorange"] = true;
    }
    return Plotly.relayout(div, change).then(function () { return draw(div); });
  }

  function onKey(event) {
    if (event.target !== event.currentTarget || event.ctrlKey || event.metaKey || event.altKey) return;
    const div = event.currentTarget;
    const act = {
      ArrowLeft: () => view(div, "x", -0.15, 1), ArrowRight: () => view(div, "x", 0.15, 1),
      ArrowUp: () => view(div, "y", 0.15, 1), ArrowDown: () => view(div, "y", -0.15, 1),
      "+": () => view(div, "x", 0, 0.7), "=": () => view(div, "x", 0, 0.7), "-": () => view(div, "x", 0, 1 / 0.7),
      "0": () => showAll(div),
    }[event.key];
    if (act) { event.preventDefault(); act(); }
  }

  // Which figures of a plot stand on paper: those a reader ticked, by their places.
  function ticked(div) {
    const box = document.querySelector('[data-tick="' + div.id + '"]');
    if (!box) return;
    const select = document.querySelector('select[data-for="' + div.id + '"]');
    const count = document.querySelector('[data-count="' + div.id + '"]');
    const tell = function () {
      box.checked = div.printed.has(Number(select.value));
      count.textContent = div.printed.size + " of " + div.choices.length + " on paper";
    };
    select.addEventListener("change", tell);
    box.addEventListener("change", function () {
      div.printed[box.checked ? "add" : "delete"](Number(select.value));
      tell();
    });
    tell();
  }

  // On paper the selected figures take the place of the one that is shown.
  function unfold(div) {
    if (div.choices.length < 2 || !div.printed.size) return;
    const place = document.createElement("div"), across = Number(div.dataset.across);
    place.className = "unfolded";
    place.style.gridTemplateColumns = "repeat(" + across + ", minmax(0, 1fr))";
    div.parentNode.insertBefore(place, div);
    div.parentNode.classList.add("folded");
    for (const k of Array.from(div.printed).sort((a, b) => a - b)) {
      const copy = document.createElement("div"), name = document.createElement("p"), plot = document.createElement("div");
      copy.className = "copy";
      name.textContent = div.choices[k].label;
      plot.style.height = (across > 1 ? 250 : Math.min(parseInt(div.style.height), 400)) + "px";
      copy.append(name, plot);
      place.append(copy);
      const figure = themed(div.choices[k].figure);
      Plotly.newPlot(plot, figure.data, figure.layout, {staticPlot: true});
    }
  }

  // A table wider than the paper is set in smaller letters.
  function fitTable(table) {
    const wide = table.scrollWidth / table.parentNode.clientWidth;
    if (wide > 1) table.style.fontSize = 0.97 * parseFloat(getComputedStyle(table).fontSize) / wide + "px";
  }

  // Mode shapes: one that moves on screen, all of them side by side on paper.
  function numbers(text) {
    return Array.from(new Float32Array(Uint8Array.from(atob(text), (c) => c.charCodeAt(0)).buffer));
  }
  function shapeColours() {
    const c = colours();
    return {ink: c.ink, quiet: c.ink, line: dark.matches && !printing ? "#5b6673" : "#b4bcc5", ground: c.ground};
  }
  const moving = Array.from(document.querySelectorAll("figure.moving")).map(function (figure) {
    const drawn = JSON.parse(document.getElementById(figure.dataset.source).textContent);
    const shape = ModalShape(figure.querySelector("canvas"), drawn, shapeColours);
    const select = figure.querySelector("select"), button = figure.querySelector("button");
    const show = () => shape.show(numbers(drawn.modes[Number(select.value)].u));
    select.addEventListener("change", show);
    button.addEventListener("click", function () {
      if (shape.playing()) shape.still(); else shape.play(true);
      button.textContent = shape.playing() ? "Stop" : "Move";
    });
    show();
    if (!window.matchMedia("(prefers-reduced-motion: reduce)").matches) button.click();
    return {
      draw: shape.draw,
      toPaper: function () {
        const paper = figure.querySelector(".paper");
        paper.replaceChildren(...drawn.modes.map(function (mode) {
          const part = document.createElement("div"), canvas = document.createElement("canvas");
          part.append(mode.label, canvas);
          return part;
        }));
        drawn.modes.forEach(function (mode, k) {
          ModalShape(paper.children[k].querySelector("canvas"), drawn, shapeColours).show(numbers(mode.u));
        });
      },
      fromPaper: () => figure.querySelector(".paper").replaceChildren(),
    };
  });

  for (const div of plots) {
    div.choices = JSON.parse(document.getElementById(div.dataset.source).textContent);
    div.printed = new Set((div.dataset.paper || "").split(" ").filter(Boolean).map(Number));
    ticked(div);
    div.addEventListener("keydown", onKey);
    draw(div);
  }
  for (const select of document.querySelectorAll("select[data-for]")) {
    select.addEventListener("change", function () { draw(document.getElementById(select.dataset.for)); });
  }
  dark.addEventListener("change", function () { plots.forEach(draw); moving.forEach((m) => m.draw()); });
  window.addEventListener("beforeprint", function () {
    printing = true;
    document.documentElement.classList.add("printing");
    plots.forEach(function (div) { draw(div); Plotly.Plots.resize(div); });
    plots.forEach(unfold);
    document.querySelectorAll("table").forEach(fitTable);
    moving.forEach(function (m) { m.toPaper(); });
  });
  window.addEventListener("afterprint", function () {
    printing = false;
    document.documentElement.classList.remove("printing");
    document.querySelectorAll("table").forEach((table) => { table.style.fontSize = ""; });
    document.querySelectorAll(".unfolded").forEach((place) => place.remove());
    document.querySelectorAll(".folded").forEach((figure) => figure.classList.remove("folded"));
    plots.forEach(function (div) { draw(div); Plotly.Plots.resize(div); });
    moving.forEach(function (m) { m.fromPaper(); m.draw(); });
  });
  document.documentElement.dataset.ready = "yes";
})();
