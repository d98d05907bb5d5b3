// Search in a site that is opened from a folder. Browsers do not start workers from file: addresses, so the theme's
// search worker runs in a hidden frame, which has the same interface. The theme expects a script of this name.
if (location.protocol === "file:") {
  window.Worker = class extends EventTarget {
    constructor(address) {
      super();
      const frame = document.createElement("iframe");
      frame.hidden = true;
      document.body.append(frame);
      const scope = frame.contentWindow;
      scope.postMessage = (data) => this.dispatchEvent(new MessageEvent("message", { data }));
      const script = frame.contentDocument.createElement("script");
      script.src = address;
      const loaded = new Promise((resolve) => script.addEventListener("load", resolve));
      frame.contentDocument.body.append(script);
      this.postMessage = async (data) => {
        await loaded;
        scope.dispatchEvent(new MessageEvent("message", { data: scope.structuredClone(data) }));
      };
      this.terminate = () => frame.remove();
    }
  };
}
