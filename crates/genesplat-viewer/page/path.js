// A camera path: views that are kept one after the other, and saved as a file that `genesplat render --path` reads.

export class CameraPath {
  #views = [];
  #elements;

  constructor(elements, currentPose) {
    this.#elements = elements;
    elements.add.addEventListener("click", () => this.keep(currentPose()));
    elements.clear.addEventListener("click", () => { this.#views = []; this.#show(); });
    elements.save.addEventListener("click", () => this.#save());
  }

  keep({ position, rotation, fov_y }) {
    this.#views.push({ position, rotation, fov_y });
    this.#show();
  }

  #show() {
    const count = this.#views.length;
    const { save, clear, count: text } = this.#elements;
    save.disabled = count < 2;
    clear.disabled = count === 0;
    text.textContent = count === 1 ? "1 view kept; a path needs two." : `${count} views kept.`;
  }

  #save() {
    const text = JSON.stringify({ genesplat_path: 1, views: this.#views }, null, 1);
    const link = document.createElement("a");
    link.href = URL.createObjectURL(new Blob([text], { type: "application/json" }));
    link.download = "path.json";
    link.click();
    setTimeout(() => URL.revokeObjectURL(link.href), 1000);
  }
}
