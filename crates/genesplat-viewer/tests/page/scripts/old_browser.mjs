// Without import maps no module of a sent page runs: its classic script is all there is to say so.

import assert from "node:assert";
import { readFileSync } from "node:fs";

const page = readFileSync(`${process.argv[2]}/sent/index.html`, "utf8");
const script = page.split("<script>")[1]?.split("</script>")[0] ?? "";

function said(HTMLScriptElement) {
  const message = { textContent: "Unpacking" };
  new Function("HTMLScriptElement", "document", script)(HTMLScriptElement, { getElementById: () => message });
  return message.textContent;
}

assert.strictEqual(said({ supports: (kind) => kind === "importmap" }), "Unpacking");
for (const old of [{}, { supports: () => false }]) assert(said(old).includes("too old"), said(old));
assert(!/\?\.|=>|const|let/.test(script), "old browsers would not read it");
