// Steps of a person on the page of a view; what was seen is left in an element of its own.
(async function () {
  const root = document.documentElement, before = sessionStorage.getItem("seen");
  const seen = before ? JSON.parse(before) : {errors: []};
  const wait = (ms) => new Promise((done) => setTimeout(done, ms));
  const until = async (what) => { for (let k = 0; k < 200 && !what(); k++) await wait(50); };
  const idle = async () => { await wait(60); await until(() => !document.body.classList.contains("busy")); };
  const rows = () => document.querySelectorAll("#modes tbody tr");
  const state = () => document.getElementById("state").textContent;
  const press = async (id) => { document.getElementById(id).click(); await idle(); };
  window.addEventListener("error", (event) => seen.errors.push(event.message));
  try {
    await until(() => root.dataset.ready);
    if (before) {
      seen.reloaded = Array.from(rows()).map((row) => row.querySelector("input").value);
      throw "done";
    }
    const diagram = document.getElementById("diagram");
    seen.opened = rows().length;
    seen.plots = ["diagram", "curve", "mac"].map((id) => document.getElementById(id).querySelectorAll(".main-svg").length > 0);
    const points = diagram.data.filter((t) => t.meta === "poles").pop();
    // A click of the mouse on a pole that is picked: it is dropped.
    const at = async (x, y) => {
      const full = diagram._fullLayout, box = diagram.querySelector(".nsewdrag").getBoundingClientRect();
      const place = {bubbles: true, cancelable: true, view: window, clientX: box.left + full.xaxis.c2p(x), clientY: box.top + full.yaxis.c2p(y)};
      const drag = document.elementFromPoint(place.clientX, place.clientY);
      drag.dispatchEvent(new MouseEvent("mousemove", place));
      await wait(80);
      drag.dispatchEvent(new MouseEvent("mousedown", place));
      document.dispatchEvent(new MouseEvent("mouseup", place));
      drag.dispatchEvent(new MouseEvent("click", place));
      await idle();
    };
    const ring = diagram.layout.shapes.filter((s) => s.type === "circle")[2];
    await at(ring.xanchor, ring.yanchor);
    seen.dropped = rows().length;
    await at(ring.xanchor, ring.yanchor);
    seen.picked = rows().length;
    rows()[1].querySelectorAll("button")[0].click();
    await idle();
    seen.less = rows().length;
    await press("undo");
    seen.undone = rows().length;
    const output = document.getElementById("output");
    output.value = output.options[2].value;
    output.dispatchEvent(new Event("change"));
    await idle();
    seen.phase = document.getElementById("curve").data.length;
    const name = rows()[0].querySelector("input");
    name.value = "<i>bending</i>";
    name.dispatchEvent(new Event("change"));
    await idle();
    seen.name = rows()[0].querySelector("input").value;
    document.getElementById("file").value = "picks.json";
    document.querySelector("#save button").click();
    await idle();
    seen.saved = state();
    document.querySelector("#save button").click();
    await idle();
    seen.again = state();
    seen.buttons = Array.from(document.querySelectorAll(".modebar-btn")).map((button) => button.dataset.title);
    if (!document.getElementById("besidePart").hidden) {
      const cross = document.getElementById("cross");
      seen.beside = {title: document.getElementById("besideName").textContent, hint: document.getElementById("besideHint").textContent,
                     mac: cross.data[0].z, names: cross.data[0].x};
    }
    await until(() => root.dataset.checked);
    seen.findings = document.getElementById("findings").textContent;
    seen.title = document.getElementById("title").textContent;
    seen.overflow = root.scrollWidth - root.clientWidth;
    rows()[1].click();
    await idle();
    if (document.getElementById("play").textContent === "Stop") await press("play");
    const canvas = document.getElementById("shape");
    const bytes = canvas.getContext("2d").getImageData(0, 0, canvas.width, canvas.height).data;
    seen.colours = new Set(new Uint32Array(bytes.buffer)).size;
    seen.overlaid = 0;
    for (let k = 0; k < bytes.length; k += 4) seen.overlaid += bytes[k] > 180 && bytes[k + 1] < 130 && bytes[k + 2] < 80;
    sessionStorage.setItem("seen", JSON.stringify(seen));
    location.reload();
    return;
  } catch (error) { if (error !== "done") seen.errors.push(String(error)); }
  const out = document.createElement("pre");
  out.id = "seen";
  out.textContent = JSON.stringify(seen);
  document.body.append(out);
})();
