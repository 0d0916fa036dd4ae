// Curves of a run as SVG: loss, PSNR of the test photos, number of Gaussians, and what evolution did.

const SVG = "http://www.w3.org/2000/svg";
const [WIDTH, HEIGHT] = [300, 80];

const CHARTS = [
  { key: "loss", name: "Loss", digits: 4 },
  { key: "psnr", name: "Test PSNR, dB", digits: 2 },
  { key: "gaussians", name: "Gaussians", digits: 0 },
];

export class Charts {
  #charts;
  #stages;

  constructor(place) {
    this.#charts = CHARTS.map((chart) => new Chart(place, chart));
    this.#stages = new Chart(place, { key: "stages", name: "Evolution, dB gained by guards", digits: 2 });
  }

  show({ stages, loss, psnr, gaussians }) {
    const curves = { loss, psnr, gaussians };
    const iterations = [...Object.values(curves).flat().map(([at]) => at), ...stages.map(({ iteration }) => iteration)];
    const end = Math.max(1, ...iterations);
    this.#charts.forEach((chart) => chart.show(curves[chart.key], end));
    this.#stages.showStages(stages, end);
  }
}

class Chart {
  key;
  #name;
  #digits;
  #figure = document.createElement("figure");
  #value = document.createElement("span");
  #drawing = element("svg", { viewBox: `0 0 ${WIDTH} ${HEIGHT}`, preserveAspectRatio: "none", role: "img" });
  // Ends of the two axes; what they say is in the label of the drawing, too.
  #scale = Object.fromEntries(["high", "low", "first", "last"].map((end) => [end, scaleEnd(end)]));
  // Iteration, value, and of a stage whether it was kept.
  #points = [];
  #end = 1;
  // What the caption says while nothing is pointed at.
  #resting = "";

  constructor(place, { key, name, digits }) {
    this.key = key;
    this.#name = name;
    this.#digits = digits;
    const caption = document.createElement("figcaption");
    const label = document.createElement("b");
    label.textContent = name;
    this.#value.className = "number";
    caption.append(label, this.#value);
    this.#figure.className = "chart";
    this.#figure.hidden = true;
    const plot = document.createElement("div");
    plot.className = "plot";
    plot.append(...Object.values(this.#scale), this.#drawing);
    this.#figure.append(caption, plot);
    this.#drawing.addEventListener("pointermove", (event) => this.#point(event));
    this.#drawing.addEventListener("pointerleave", () => this.#rest());
    place.append(this.#figure);
  }

  show(points, end) {
    [this.#points, this.#end] = [points, end];
    this.#figure.hidden = points.length < 2;
    if (points.length < 2) return;
    const values = points.map(([, value]) => value);
    const [low, high] = [Math.min(...values), Math.max(...values)];
    const y = (value) => HEIGHT - 3 - ((value - low) / (high - low || 1)) * (HEIGHT - 8);
    const line = points.map(([at, value]) => `${((at / end) * WIDTH).toFixed(1)} ${y(value).toFixed(1)}`).join("L");
    this.#drawing.replaceChildren(this.#axis(), element("path", { class: "curve", d: `M${line}` }));
    this.#label(this.#format(low), this.#format(high));
    const [at, last] = points.at(-1);
    this.#describe(`${this.#name}: ${this.#format(last)} at iteration ${at}; from ${this.#format(low)} to ${this.#format(high)}`);
    this.#resting = this.#format(last);
    this.#rest();
  }

  // A tick for each stage: up by what it gained or down by what it cost, and short where it was taken back.
  showStages(stages, end) {
    [this.#points, this.#end] = [stages.map(({ iteration, gain, kept }) => [iteration, kept ? gain ?? 0 : 0, kept]), end];
    this.#figure.hidden = stages.length === 0;
    const gains = this.#points.map(([, gain]) => gain);
    const [low, high] = [Math.min(0, ...gains), Math.max(0.01, ...gains)];
    const y = (gain) => HEIGHT - 8 - ((gain - low) / (high - low)) * (HEIGHT - 14);
    // Averages that are kept may cost guards a little; then the axis has room below it.
    const zero = low < 0 ? y(0) : HEIGHT - 1;
    const ticks = this.#points.map(([iteration, gain, kept]) => {
      const x = (iteration / end) * WIDTH;
      const tip = kept ? y(gain) : zero - 5;
      return element("line", { class: kept ? "kept" : "refused", x1: x, x2: x, y1: zero, y2: tip });
    });
    this.#drawing.replaceChildren(this.#axis(zero + 0.5), ...ticks);
    this.#label("", "");
    const kept = stages.filter((stage) => stage.kept).length;
    this.#describe(`${kept} of ${stages.length} stages of evolution were kept`);
    this.#resting = `${kept} of ${stages.length} kept`;
    this.#rest();
  }

  #axis(y = HEIGHT - 0.5) {
    return element("line", { class: "axis", x1: 0, x2: WIDTH, y1: y, y2: y });
  }

  #label(low, high) {
    const texts = { low, high, first: "0", last: this.#end.toLocaleString("en") };
    Object.entries(texts).forEach(([end, text]) => (this.#scale[end].textContent = text));
  }

  #describe(text) {
    this.#drawing.setAttribute("aria-label", text);
  }

  #format(value) {
    return value.toLocaleString("en", { minimumFractionDigits: this.#digits, maximumFractionDigits: this.#digits });
  }

  #rest() {
    this.#drawing.querySelector(".pointer")?.remove();
    this.#value.textContent = this.#resting;
  }

  #point(event) {
    const box = this.#drawing.getBoundingClientRect();
    const wanted = ((event.clientX - box.left) / box.width) * this.#end;
    const nearest = this.#points.reduce((best, point) => (Math.abs(point[0] - wanted) < Math.abs(best[0] - wanted) ? point : best));
    const x = (nearest[0] / this.#end) * WIDTH;
    this.#drawing.querySelector(".pointer")?.remove();
    this.#drawing.append(element("line", { class: "pointer", x1: x, x2: x, y1: 0, y2: HEIGHT }));
    const [, value, isKept] = nearest;
    const what = isKept === false ? "taken back" : this.#format(value);
    this.#value.textContent = `${what} at ${Math.round(nearest[0]).toLocaleString("en")}`;
  }
}

function scaleEnd(end) {
  const made = document.createElement("span");
  made.className = `number ${end}`;
  made.ariaHidden = "true";
  return made;
}

function element(name, attributes) {
  const made = document.createElementNS(SVG, name);
  Object.entries(attributes).forEach(([key, value]) => made.setAttribute(key, value));
  return made;
}
