// What the run does, in words and numbers; and the buttons that steer it.

const NOTICE_MS = 7000;

const PHASES = {
  training: "training",
  paused: "paused",
  scoring: "scoring photos",
  ended: "finished",
  viewing: "finished splat",
  following: "training, as last saved",
  waiting: "training, nothing saved yet",
  lost: "connection lost, trying again",
};

// How long is left, in words that are as exact as can be known.
export function timeLeft(seconds) {
  if (seconds < 90) return `${Math.ceil(seconds)} s left`;
  if (seconds < 3600) return `${Math.round(seconds / 60)} min left`;
  const minutes = Math.round(seconds / 60);
  return `${Math.floor(minutes / 60)} h ${String(minutes % 60).padStart(2, "0")} min left`;
}

export class Status {
  phase = "connecting";
  #snapshotWait = 0;
  #title = "genesplat";
  #at = (id) => document.getElementById(id);
  #noticeTimer = 0;

  constructor(send) {
    this.#at("pause").addEventListener("click", () => this.togglePause(send));
    this.#at("snapshot").addEventListener("click", () => send({ type: "snapshot" }));
    const dialog = this.#at("stop-dialog");
    this.#at("stop").addEventListener("click", () => dialog.showModal());
    for (const id of ["download-splat", "download-page"]) {
      this.#at(id).addEventListener("click", () => this.notice("The file is being made, and comes as a download."));
    }
    dialog.addEventListener("close", () => { if (dialog.returnValue === "stop") send({ type: "stop" }); dialog.returnValue = ""; });
  }

  greet({ title, can_train }) {
    this.#at("title").textContent = title;
    document.title = `${title} – genesplat`;
    this.#at("run-actions").hidden = !can_train;
    this.#title = title;
    this.#nameDownloads(0);
  }

  // What was edited has another name than what was not.
  #nameDownloads(edits) {
    const name = edits > 0 ? `${this.#title}-edited` : this.#title;
    this.#at("download-splat").download = `${name}.ply`;
    this.#at("download-page").download = `${name}.html`;
  }

  show({ phase, iteration, iterations, gaussians, loss, psnr, device, snapshot_wait, seconds_left = null, can_download = false, edits = 0 }) {
    this.#snapshotWait = snapshot_wait;
    this.setPhase(phase);
    this.#showSnapshot();
    const count = (value) => value.toLocaleString("en");
    const total = iterations ? ` of ${count(iterations)}` : "";
    this.#text("iteration", iteration ? `iteration ${count(iteration)}${total}` : "");
    this.#at("iteration").dataset.iteration = iteration;
    this.#text("gaussians", count(gaussians));
    this.#text("loss", loss === null ? "–" : loss.toFixed(4));
    this.#text("psnr", psnr === null ? "–" : `${psnr.toFixed(2)} dB`);
    this.#text("device", device);
    const isTraining = phase === "training" || phase === "following";
    this.#text("left", isTraining && seconds_left !== null ? timeLeft(seconds_left) : "");
    this.#at("downloads").hidden = !can_download;
    this.#nameDownloads(edits);
    // Who came while the run trained sees no buttons that do nothing.
    if (phase === "viewing") this.#at("run-actions").hidden = true;
    const progress = this.#at("progress");
    progress.hidden = !iterations;
    progress.value = iterations ? iteration / iterations : 0;
  }

  setPhase(phase) {
    if (phase === this.phase) return;
    this.phase = phase;
    const label = this.#at("phase");
    label.textContent = PHASES[phase];
    label.dataset.phase = phase;
    const isRunning = phase === "training" || phase === "paused";
    this.#text("pause", phase === "paused" ? "Go on" : "Pause");
    for (const id of ["pause", "stop"]) this.#at(id).disabled = !isRunning;
    this.#showSnapshot();
  }

  // The run saves one in some seconds at most.
  #showSnapshot() {
    const isRunning = this.phase === "training" || this.phase === "paused";
    this.#at("snapshot").disabled = !isRunning || this.#snapshotWait > 0;
    this.#text("snapshot", this.#snapshotWait > 0 ? `Snapshot (in ${this.#snapshotWait} s)` : "Snapshot");
  }

  togglePause(send) {
    if (this.#at("run-actions").hidden || this.#at("pause").disabled) return;
    send({ type: this.phase === "paused" ? "resume" : "pause" });
  }

  notice(text) {
    const place = this.#at("notice");
    place.hidden = false;
    place.textContent = text;
    clearTimeout(this.#noticeTimer);
    this.#noticeTimer = setTimeout(() => { place.hidden = true; }, NOTICE_MS);
  }

  // Only what has changed, so that a screen reader is left alone.
  #text(id, text) {
    const place = this.#at(id);
    if (place.textContent !== text) place.textContent = text;
  }
}
