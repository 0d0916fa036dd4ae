// The strip of thumbnails, one for each camera of the scene.

export class CameraStrip {
  #strip;
  #list;
  #buttons = [];
  #onChoose;

  constructor(strip, onChoose) {
    this.#strip = strip;
    this.#list = strip.querySelector("ul");
    this.#onChoose = onChoose;
  }

  fill(cards) {
    this.#strip.hidden = cards.length === 0;
    this.#buttons = cards.map((card) => this.#button(card));
    this.#list.replaceChildren(...this.#buttons.map((button) => {
      const item = document.createElement("li");
      item.append(button);
      return item;
    }));
  }

  #button(card) {
    const button = document.createElement("button");
    const image = document.createElement("img");
    [image.width, image.height] = [Math.round((58 * card.width) / card.height), 58];
    image.loading = "lazy";
    image.alt = "";
    image.src = card.thumbnail;
    button.type = "button";
    button.append(image);
    button.title = card.name;
    button.setAttribute("aria-label", `${card.name}, ${card.split === "test" ? "test photo" : "training photo"}`);
    button.classList.toggle("test", card.split === "test");
    button.addEventListener("click", () => this.#onChoose(card));
    return button;
  }

  // Marks the camera that is looked through; `null` for none.
  mark(card) {
    this.#buttons.forEach((button, index) => {
      if (index === card?.index) button.setAttribute("aria-current", "true");
      else button.removeAttribute("aria-current");
    });
    const button = card && this.#buttons[card.index];
    if (button) {
      const middle = button.offsetLeft - (this.#strip.clientWidth - button.offsetWidth) / 2;
      this.#strip.scrollTo({ left: middle, behavior: "instant" });
    }
  }
}
