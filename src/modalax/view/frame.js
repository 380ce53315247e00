// How the page asks when it stands in a frame of a notebook: by messages to the frame's owner, answered by number.
"use strict";
(function () {
  const waiting = new Map();
  let count = 0, progress = "";
  window.addEventListener("message", function (event) {
    if (event.source !== window.parent) return;
    const told = event.data;
    if (told.progress !== undefined) { progress = told.progress; return; }
    const number = Number(told.number.split(":")[1]);
    const [done, failed] = waiting.get(number) || [];
    waiting.delete(number);
    if (!done) return;
    if (told.error !== undefined) failed(new Error(told.error)); else done(told.value);
  });
  window.modalaxAsk = function (name, message) {
    if (name === "progress") return Promise.resolve({step: progress});
    return new Promise(function (done, failed) {
      count += 1;
      waiting.set(count, [done, failed]);
      window.parent.postMessage({number: ":" + count, name: name, message: message || {}}, "*");
    });
  };
})();
