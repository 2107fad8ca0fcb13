// The search runs in a worker, and browsers start none for pages that are opened from the disk. There, its script runs in
// a hidden frame, whose window gets the two functions that a worker has and a window lacks.
class FrameAsWorker extends EventTarget {
  constructor(script) {
    super();
    this.begun = new Promise((begun) => {
      const frame = document.createElement("iframe");
      frame.hidden = true;
      frame.onload = () => {
        const scope = frame.contentWindow;
        scope.postMessage = (data) => this.answer(data);
        scope.importScripts = (...scripts) => inTurn(scope.document, scripts);
        inTurn(scope.document, [script]).then(() => begun(scope));
      };
      document.body.append(frame);
    });
  }

  postMessage(data) {
    this.begun.then((scope) => scope.dispatchEvent(new scope.MessageEvent("message", { data })));
  }

  answer(data) {
    const message = new MessageEvent("message", { data });
    this.dispatchEvent(message);
    this.onmessage?.(message);
  }
}

// Run scripts one after the other; unlike a worker's importScripts, this returns before they have run.
async function inTurn(page, scripts) {
  for (const address of scripts) {
    await new Promise((done) => {
      const element = page.createElement("script");
      element.src = address;
      element.onload = done;
      page.body.append(element);
    });
  }
}

if (location.protocol === "file:") window.Worker = FrameAsWorker;
