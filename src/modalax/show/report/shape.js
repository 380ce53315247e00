"use strict";
// A mode shape on a canvas: the structure at rest in grey, the moving one coloured by how far, a partner dashed.
// geometry: {xyz: [[x, y, z], ...], pieces: [[a, b], ...], placed: whether xyz are places in metres}.
// A shape is real and imaginary part of every node's displacement, [x re, x im, y re, y im, z re, z im, ...], largest 1.
function ModalShape(canvas, geometry, colours) {
  const LARGEST = 0.15;  // displacement drawn, as a part of the structure's size
  const PERIOD = 1600;   // of the motion [ms]
  const VIRIDIS = [[68, 1, 84], [59, 82, 139], [33, 145, 140], [94, 201, 98], [253, 231, 37]];
  const xyz = geometry.xyz, pieces = geometry.pieces;
  const flat = !geometry.placed;
  const home = flat ? {azimuth: -Math.PI / 2, elevation: 0.0} : {azimuth: -1.0, elevation: 0.5};
  const view = Object.assign({zoom: 1}, home);
  const low = [0, 1, 2].map((k) => Math.min(...xyz.map((p) => p[k])));
  const high = [0, 1, 2].map((k) => Math.max(...xyz.map((p) => p[k])));
  const middle = low.map((v, k) => (v + high[k]) / 2);
  const size = Math.max(...high.map((v, k) => v - low[k])) || 1;
  let ends = [0, 0.92];  // part of the colours that is seen on the ground: no violet on black, no yellow on white
  let shape = null, other = null, playing = false, began = 0, phase = 0, seen = true;

  function tint(part) {
    const at = (ends[0] + Math.min(Math.max(part, 0), 1) * (ends[1] - ends[0])) * (VIRIDIS.length - 1), k = Math.min(Math.floor(at), VIRIDIS.length - 2);
    const mixed = VIRIDIS[k].map((v, c) => Math.round(v + (at - k) * (VIRIDIS[k + 1][c] - v)));
    return "rgb(" + mixed.join(",") + ")";
  }

  // Where a point is seen, in lengths of the structure: to the right and upwards.
  function project(p) {
    const d = p.map((v, k) => v - middle[k]);
    const ca = Math.cos(view.azimuth), sa = Math.sin(view.azimuth);
    const ce = Math.cos(view.elevation), se = Math.sin(view.elevation);
    return [-sa * d[0] + ca * d[1], -ca * se * d[0] - sa * se * d[1] + ce * d[2]];
  }

  function displaced(u, factor) {
    const c = Math.cos(phase), s = Math.sin(phase);
    return xyz.map(function (p, n) {
      const d = [0, 1, 2].map((k) => u[6 * n + 2 * k] * c - u[6 * n + 2 * k + 1] * s);
      return {at: p.map((v, k) => v + factor * d[k]), far: Math.hypot(...d)};
    });
  }

  // Scale and shift that keep the whole structure in view, at its largest displacement too.
  function fitted(width, height, room) {
    const ends = [[Infinity, -Infinity], [Infinity, -Infinity]];
    for (const p of xyz) {
      project(p).forEach(function (v, k) {
        ends[k][0] = Math.min(ends[k][0], v - room);
        ends[k][1] = Math.max(ends[k][1], v + room);
      });
    }
    const span = ends.map((e) => Math.max(e[1] - e[0], 1e-12));
    const scale = view.zoom * Math.min((width - 96) / span[0], (height - 24) / span[1]);
    const centre = ends.map((e) => (e[0] + e[1]) / 2);
    return (p) => [(width - 72) / 2 + scale * (p[0] - centre[0]), height / 2 - scale * (p[1] - centre[1])];
  }

  function lines(pen, points, paint, width, dash) {
    pen.setLineDash(dash || []);
    pen.lineWidth = width;
    for (const [a, b] of pieces) {
      pen.strokeStyle = paint(a, b);
      pen.beginPath();
      pen.moveTo(points[a][0], points[a][1]);
      pen.lineTo(points[b][0], points[b][1]);
      pen.stroke();
    }
    pen.setLineDash([]);
  }

  function dots(pen, points, paint, radius) {
    points.forEach(function (p, n) {
      pen.fillStyle = paint(n);
      pen.beginPath();
      pen.arc(p[0], p[1], radius, 0, 2 * Math.PI);
      pen.fill();
    });
  }

  function legend(pen, width, height, c) {
    const x = width - 58, top = 26, tall = Math.max(height - 70, 40);
    for (let k = 0; k < 60; k++) {
      pen.fillStyle = tint(1 - k / 59);
      pen.fillRect(x, top + tall * k / 60, 12, tall / 60 + 1);
    }
    pen.fillStyle = c.ink;
    pen.font = "12px system-ui, sans-serif";
    pen.textAlign = "left";
    [["1", 0], ["0.5", 0.5], ["0", 1]].forEach(([t, at]) => pen.fillText(t, x + 17, top + 4 + tall * at));
    pen.textAlign = "right";
    pen.fillText("displacement [-]", width - 4, 14);
  }

  function axes(pen, height, c) {
    const start = [34, height - 30], zero = project(middle);
    pen.font = "12px system-ui, sans-serif";
    pen.textAlign = "center";
    "xyz".split("").forEach(function (name, k) {
      const tip = project(middle.map((v, j) => v + (j === k ? 1 : 0))).map((v, j) => v - zero[j]);
      pen.strokeStyle = pen.fillStyle = c.quiet;
      pen.lineWidth = 1;
      pen.beginPath();
      pen.moveTo(...start);
      pen.lineTo(start[0] + 22 * tip[0], start[1] - 22 * tip[1]);
      pen.stroke();
      if (Math.hypot(...tip) > 0.2) pen.fillText(name, start[0] + 30 * tip[0], start[1] - 30 * tip[1] + 4);
    });
  }

  function draw() {
    const ratio = window.devicePixelRatio || 1, width = canvas.clientWidth || 600, height = canvas.clientHeight || 360;
    if (canvas.width !== Math.round(width * ratio) || canvas.height !== Math.round(height * ratio)) {
      canvas.width = Math.round(width * ratio);
      canvas.height = Math.round(height * ratio);
    }
    const pen = canvas.getContext("2d"), c = colours();
    ends = parseInt(c.ground.slice(1, 3), 16) < 128 ? [0.3, 1] : [0, 0.92];
    pen.setTransform(ratio, 0, 0, ratio, 0, 0);
    pen.fillStyle = c.ground;
    pen.fillRect(0, 0, width, height);
    const place = fitted(width, height, LARGEST * size);
    const rest = xyz.map((p) => place(project(p)));
    lines(pen, rest, () => c.line, 1);
    dots(pen, rest, () => c.line, 1.5);
    if (shape) {
      if (other) {
        const points = displaced(other, LARGEST * size).map((d) => place(project(d.at)));
        lines(pen, points, () => "#d55e00", 1.5, [5, 4]);
        if (!pieces.length) dots(pen, points, () => "#d55e00", 2);
      }
      const now = displaced(shape, LARGEST * size), points = now.map((d) => place(project(d.at)));
      lines(pen, points, (a, b) => tint((now[a].far + now[b].far) / 2), 2.2);
      dots(pen, points, (n) => tint(now[n].far), pieces.length ? 2.2 : 3);
    }
    legend(pen, width, height, c);
    if (!flat) axes(pen, height, c);
  }

  function step(time) {
    if (!playing) return;
    if (seen) {
      phase = 2 * Math.PI * ((time - began) % PERIOD) / PERIOD;
      draw();
    }
    window.requestAnimationFrame(step);
  }

  function play(yes) {
    if (yes && !playing) {
      playing = true;
      window.requestAnimationFrame(function (time) { began = time - phase / (2 * Math.PI) * PERIOD; step(time); });
    } else if (!yes) {
      playing = false;
    }
  }

  let held = null;
  canvas.addEventListener("pointerdown", function (event) {
    held = [event.clientX, event.clientY];
    canvas.setPointerCapture(event.pointerId);
  });
  canvas.addEventListener("pointermove", function (event) {
    if (!held) return;
    view.azimuth -= 0.01 * (event.clientX - held[0]);
    view.elevation = Math.min(Math.max(view.elevation + 0.01 * (event.clientY - held[1]), -1.57), 1.57);
    held = [event.clientX, event.clientY];
    draw();
  });
  canvas.addEventListener("pointerup", function () { held = null; });
  canvas.addEventListener("wheel", function (event) {
    event.preventDefault();
    view.zoom = Math.min(Math.max(view.zoom * Math.exp(-0.001 * event.deltaY), 0.2), 20);
    draw();
  }, {passive: false});
  canvas.addEventListener("dblclick", function () { Object.assign(view, {zoom: 1}, home); draw(); });
  if (window.IntersectionObserver) new IntersectionObserver((e) => { seen = e[e.length - 1].isIntersecting; }).observe(canvas);
  if (window.ResizeObserver) new ResizeObserver(draw).observe(canvas);

  return {
    show: function (u, partner) { shape = u; other = partner || null; draw(); },
    still: function () { playing = false; phase = 0; draw(); },
    play: play, playing: () => playing, draw: draw,
  };
}
