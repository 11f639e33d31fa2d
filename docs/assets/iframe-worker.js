// Lets the search work where a page is opened from a folder: browsers start no worker from a file.
// A hidden frame runs the worker's script instead, and messages are events between the two windows.
if (location.protocol === "file:") {
  window.Worker = class extends EventTarget {
    constructor(url) {
      super();
      this.waiting = [];
      this.frame = document.createElement("iframe");
      this.frame.hidden = true;
      document.body.append(this.frame);

      const inner = this.frame.contentWindow;
      inner.postMessage = (data) => {
        const event = new MessageEvent("message", { data });
        this.dispatchEvent(event);
        this.onmessage?.(event);
      };
      const script = inner.document.createElement("script");
      script.src = new URL(url, document.baseURI);
      script.onerror = (event) => this.onerror?.(event);
      // What was said before the script had been read is told now.
      script.onload = () => {
        this.waiting.splice(0).forEach((data) => this.tell(data));
        this.waiting = null;
      };
      inner.document.head.append(script);
    }

    postMessage(data) {
      this.waiting ? this.waiting.push(data) : this.tell(data);
    }

    tell(data) {
      // As a worker's messages do, it arrives later, and `onmessage` hears it as an event.
      setTimeout(() => this.frame.contentWindow?.dispatchEvent(new MessageEvent("message", { data })));
    }

    terminate() {
      this.frame.remove();
    }
  };
}
