// A matrix of similarities as an image: hover tells a cell, click picks its pair, arrow keys move from cell to cell.

class MatrixView {
  constructor(place, { title, values, names, pick }) {
    Object.assign(this, { values, names, pick, n: names.length, cell: [0, 0] });
    const stage = make("div", { className: "stage" });
    this.tip = make("div", { className: "tip" });
    this.told = make("div", { className: "note", ariaLive: "polite" }, "\u00a0");
    place.append(make("h3", {}, title), stage, this.told, make("div", { className: "legend" }, scaleLegend("0", "1", "similarity, best turn")));
    this.surface = canvas(stage, (width) => Math.min(width, 460), `${title}. Arrow keys move from cell to cell, Enter picks the pair.`,
      (...all) => this.paint(...all));
    stage.append(this.tip);
    this.picture = this.render();
    const element = this.surface.element;
    element.addEventListener("pointermove", (event) => this.over(...at(element, event)));
    element.addEventListener("pointerleave", () => { this.tip.style.display = "none"; });
    gestures(element, { drag: () => {}, pinch: () => {}, tap: (x, y) => { element.focus(); if (this.over(x, y)) this.chosen(); } });
    element.addEventListener("keydown", (event) => {
      const step = { ArrowLeft: [0, -1], ArrowRight: [0, 1], ArrowUp: [-1, 0], ArrowDown: [1, 0] }[event.key];
      if (event.key === "Enter") this.chosen();
      if (!step) return;
      event.preventDefault();
      this.cell = this.cell.map((value, k) => Math.min(this.n - 1, Math.max(0, value + step[k])));
      this.tell();
    });
  }

  render() {
    const picture = make("canvas", { width: this.n, height: this.n }), context = picture.getContext("2d");
    const image = context.createImageData(this.n, this.n);
    this.values.forEach((value, k) => image.data.set([...shade(value / 255), 255], 4 * k));
    context.putImageData(image, 0, 0);
    return picture;
  }

  paint(context, width, height) {
    this.box = { x: 46, y: 6, size: Math.min(width - 52, height - 46) };
    const { x, y, size } = this.box, step = Math.max(1, Math.ceil(this.n / Math.max(2, size / 26)));
    context.clearRect(0, 0, width, height);
    context.imageSmoothingEnabled = false;
    context.drawImage(this.picture, x, y, size, size);
    context.fillStyle = colours.faint;
    context.font = "11px system-ui, sans-serif";
    for (let k = 0; k < this.n; k += step) {
      const middle = ((k + 0.5) / this.n) * size;
      context.textAlign = "right";
      context.fillText(this.names[k], x - 5, y + middle + 4);
      context.textAlign = "center";
      context.fillText(this.names[k], x + middle, y + size + 14);
    }
    context.fillText("intersection", x + size / 2, y + size + 30);
    context.save();
    context.translate(11, y + size / 2);
    context.rotate(-Math.PI / 2);
    context.fillText("intersection", 0, 0);
    context.restore();
    const edge = size / this.n;
    context.strokeStyle = colours.proven;
    context.lineWidth = 2;
    context.strokeRect(x + this.cell[1] * edge, y + this.cell[0] * edge, edge, edge);
  }

  over(px, py) {
    const { x, y, size } = this.box, column = Math.floor(((px - x) / size) * this.n), row = Math.floor(((py - y) / size) * this.n);
    const inside = row >= 0 && column >= 0 && row < this.n && column < this.n;
    this.tip.style.display = inside ? "block" : "none";
    if (!inside) return false;
    this.cell = [row, column];
    this.tip.textContent = this.text();
    this.tip.style.left = `${Math.min(Math.max(px, 70), this.surface.element.clientWidth - 70)}px`;
    this.tip.style.top = `${Math.max(py, 40)}px`;
    this.tell();
    return true;
  }

  text() {
    const [row, column] = this.cell;
    return `${this.names[row]} and ${this.names[column]}: ${(this.values[row * this.n + column] / 255).toFixed(2)}`;
  }
  tell() { this.told.textContent = this.text(); this.surface.again(); }
  chosen() { const [row, column] = this.cell; this.pick(row, column); }
}
