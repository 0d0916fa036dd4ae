// A server without room opens each socket, says so, and closes it.

import assert from "node:assert";

import { load } from "./window.mjs";

const { Connection } = await load("live", "connection.js");
globalThis.location = { href: "http://127.0.0.1:7007/token/" };

const sockets = [];
globalThis.WebSocket = class { constructor(address) { this.address = address; sockets.push(this); } };
const delays = [];
globalThis.setTimeout = (open, milliseconds) => { delays.push(milliseconds); open(); };

const notices = [];
new Connection({ hello() {}, notice: ({ text }) => notices.push(text), close() {} });
function live(...messages) {
  const socket = sockets.at(-1);
  socket.onopen?.();
  messages.forEach((message) => socket.onmessage({ data: JSON.stringify(message) }));
  socket.onclose();
}

for (let n = 0; n < 5; n++) live({ type: "notice", text: "no room" });
assert.deepStrictEqual(delays, [500, 1000, 2000, 4000, 4000]);
assert.strictEqual(notices.length, 5);
// Whoever was let in comes back at once.
live({ type: "hello" });
assert.strictEqual(delays.at(-1), 500);

// Where the page came by TLS, a browser allows no socket without.
assert.strictEqual(String(sockets[0].address), "ws://127.0.0.1:7007/token/socket");
globalThis.location = { href: "https://splats.example/proxy/token/" };
new Connection({ close() {} });
assert.strictEqual(String(sockets.at(-1).address), "wss://splats.example/proxy/token/socket");
