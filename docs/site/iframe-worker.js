// Browsers start no workers for pages opened from a folder. The search runs in a hidden frame of the same page there.
if (location.protocol === "file:") {
  window.Worker = class extends EventTarget {
    constructor(url) {
      super();
      const frame = document.createElement("iframe");
      frame.hidden = true;
      document.body.append(frame);
      this.inside = frame.contentWindow;
      addEventListener("message", (event) => {
        if (event.source !== this.inside) return;
        const message = new MessageEvent("message", { data: event.data });
        this.dispatchEvent(message);
        if (this.onmessage) this.onmessage(message);
      });
      this.ready = new Promise((resolve) => { this.inside.started = resolve; });
      this.inside.document.write(
        `<script>postMessage = (data) => parent.dispatchEvent(new MessageEvent("message", { data, source: window }));
        importScripts = (...names) => Promise.all(names.map((name) => new Promise((done) => {
          const script = document.createElement("script");
          Object.assign(script, { src: new URL(name, ${JSON.stringify(url)}), onload: done });
          document.body.append(script);
        })));</scr` + `ipt><script src=${JSON.stringify(url)} onload="started()"></scr` + `ipt>`);
      this.inside.document.close();
    }
    postMessage(data) {
      this.ready.then(() => this.inside.dispatchEvent(new MessageEvent("message", { data })));
    }
    terminate() {
      this.inside.frameElement.remove();
    }
  };
}
