// The frame of a view in a notebook: it hands the messages of the page to the kernel, and the answers back.
export default {
  render({model, el}) {
    const frame = document.createElement("iframe"), own = Math.random().toString(36).slice(2);
    frame.title = "modalax view";
    // Scripts and forms of the page run, but it has no access to the notebook.
    frame.setAttribute("sandbox", "allow-scripts allow-forms allow-downloads");
    frame.style.cssText = "border: 0; width: 100%; height: " + model.get("height") + "px";
    async function answered(content, buffers) {
      if (content.progress !== undefined) return frame.contentWindow.postMessage(content, "*");
      if (!content.number || !content.number.startsWith(own)) return null;
      if (!buffers || !buffers.length) return frame.contentWindow.postMessage(content, "*");
      const unpacked = new Blob([buffers[0]]).stream().pipeThrough(new DecompressionStream("gzip"));
      frame.srcdoc = await new Response(unpacked).text();
      return null;
    }
    function asked(event) {
      if (event.source !== frame.contentWindow) return;
      model.send({number: own + event.data.number, name: event.data.name, message: event.data.message});
    }
    window.addEventListener("message", asked);
    model.on("msg:custom", answered);
    el.append(frame);
    model.send({number: own, name: "page"});
    return function () {
      window.removeEventListener("message", asked);
      model.off("msg:custom", answered);
    };
  },
};
