// Browsers start no worker for a page that is opened as a file. There the search runs its worker's
// script in a hidden frame. Zensical's plugin `offline` takes a script of this name in place of one
// that it would load from elsewhere.
if (location.protocol === "file:") {
  window.Worker = class {
    constructor(url) {
      this.waiting = []; // messages before the script has run
      this.frame = document.createElement("iframe");
      this.frame.hidden = true;
      document.body.append(this.frame);
      this.scope = this.frame.contentWindow;
      const page = this.scope.document;
      page.open();
      this.scope.postMessage = (data) => {
        const copy = structuredClone(data);
        setTimeout(() => this.onmessage?.({ data: copy }));
      };
      page.write("<!doctype html><body></body>");
      page.close();
      const script = page.createElement("script");
      script.src = url;
      script.onload = () => {
        const messages = this.waiting;
        this.waiting = null;
        messages.forEach((data) => this.postMessage(data));
      };
      script.onerror = (event) => this.onerror?.(event);
      page.body.append(script);
    }

    postMessage(data) {
      if (this.waiting) {
        this.waiting.push(structuredClone(data));
      } else {
        const copy = { data: structuredClone(data) };
        this.scope.dispatchEvent(new this.scope.MessageEvent("message", copy));
      }
    }

    terminate() {
      this.frame.remove();
    }
  };
}
