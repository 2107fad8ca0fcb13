// The search of pages that are opened from the disk, where browsers start no workers: its script runs in a hidden frame.
// After iframe-worker (Martin Donath, MIT license), which the offline plugin would load from another server.
class FrameWorker extends EventTarget {
  constructor(url) {
    super();
    const frame = document.createElement("iframe");
    frame.hidden = true;
    document.body.appendChild(frame);
    this.inner = frame.contentWindow;
    addEventListener("message", (event) => {
      if (event.source !== this.inner) return;
      const answer = new MessageEvent("message", { data: event.data });
      this.dispatchEvent(answer);
      if (this.onmessage) this.onmessage(answer);
    });
    const page = this.inner.document;
    page.open();
    page.write(`<html><body><script>${inner}<\/script><script src="${url}"><\/script></body></html>`);
    page.close();
    this.ready = new Promise((resolve) => { this.inner.onload = resolve; });
  }

  postMessage(data) {
    this.ready.then(() => this.inner.dispatchEvent(new MessageEvent("message", { data: structuredClone(data) })));
  }
}

// What the script of a worker expects of its surroundings.
const inner = `
  postMessage = (data) => parent.postMessage(data, "*");
  importScripts = (...urls) => urls.reduce((before, url) => before.then(() => new Promise((resolve) => {
    const script = document.createElement("script");
    script.src = url;
    script.onload = resolve;
    document.body.appendChild(script);
  })), Promise.resolve());
`;

window.IFrameWorker = FrameWorker;
if (location.protocol === "file:") window.Worker = FrameWorker;
