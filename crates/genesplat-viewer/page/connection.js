// The socket: what the server says, and what it is asked for. It is opened again when it breaks.

const RETRY_MS = [500, 1000, 2000, 4000];

export class Connection {
  #handlers;
  #socket = null;
  #failures = 0;
  #isOver = false;

  // `handlers` has a function for each type of message: hello, state, curves, notice; and picture, close.
  constructor(handlers) {
    this.#handlers = handlers;
    this.#open();
  }

  get isOpen() {
    return this.#socket?.readyState === WebSocket.OPEN;
  }

  send(message) {
    if (this.isOpen) this.#socket.send(JSON.stringify(message));
  }

  #open() {
    const address = new URL("socket", location.href);
    // Behind a proxy with TLS a browser allows no other.
    address.protocol = address.protocol === "https:" ? "wss:" : "ws:";
    this.#socket = new WebSocket(address);
    this.#socket.binaryType = "arraybuffer";
    this.#socket.onmessage = ({ data }) => this.#hear(data);
    this.#socket.onclose = () => this.#close();
  }

  #hear(data) {
    if (data instanceof ArrayBuffer) {
      const end = 4 + new DataView(data).getUint32(0, true);
      const header = JSON.parse(new TextDecoder().decode(data.slice(4, end)));
      this.#handlers.picture(header, new Blob([data.slice(end)], { type: "image/jpeg" }));
      return;
    }
    const message = JSON.parse(data);
    // A server without room opens the socket, says so, and closes it.
    if (message.type === "hello") this.#failures = 0;
    if (message.type === "state" && message.phase === "ended") this.#isOver = true;
    this.#handlers[message.type]?.(message);
  }

  #close() {
    this.#handlers.close(this.#isOver);
    if (this.#isOver) return;
    setTimeout(() => this.#open(), RETRY_MS[Math.min(this.#failures, RETRY_MS.length - 1)]);
    this.#failures += 1;
  }
}
