// Steps of a person on the page of a view in a notebook; what was seen is sent to the kernel like any other message.
(async function () {
  const wait = (ms) => new Promise((done) => setTimeout(done, ms));
  const until = async (what) => { for (let k = 0; k < 200 && !what(); k++) await wait(50); };
  const idle = async () => { await wait(60); await until(() => !document.body.classList.contains("busy")); };
  const rows = () => document.querySelectorAll("#modes tbody tr").length;
  const state = () => document.getElementById("state").textContent;
  const press = async (button) => { button.click(); await idle(); };
  const seen = {errors: []};
  window.addEventListener("error", (event) => seen.errors.push(event.message));
  try {
    await until(() => document.documentElement.dataset.checked);
    seen.title = document.getElementById("title").textContent;
    seen.opened = rows();
    await press(document.querySelectorAll("#modes tbody tr")[1].querySelector("button"));
    seen.dropped = rows();
    document.getElementById("atHz").value = "33.9";
    await press(document.querySelector("#at button"));
    seen.picked = rows();
    await press(document.getElementById("refine"));
    seen.refined = document.querySelectorAll("#modes tbody tr")[0].children[2].textContent;
    document.getElementById("file").value = "picks.json";
    await press(document.querySelector("#save button"));
    seen.saved = state();
    await press(document.querySelector("#save button"));
    seen.again = state();
    seen.findings = document.getElementById("findings").textContent;
    seen.plots = ["diagram", "curve", "mac"].map((id) => document.getElementById(id).querySelectorAll(".main-svg").length > 0);
    try { seen.outside = window.parent.document.title; } catch (error) { seen.outside = "closed"; }
  } catch (error) { seen.errors.push(String(error)); }
  await window.modalaxAsk("seen", seen);
})();
