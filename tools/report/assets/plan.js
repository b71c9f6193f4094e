// The plan of the mine: roadways, intersections and tracks from above; pan, zoom, hover, pick one.

class PlanView {
  // pick(row) is called when an intersection is picked here.
  constructor(place, { label, pick = () => {} }) {
    Object.assign(this, { pick, selected: -1, hovered: -1, marks: page.intersections, roads: null, walls: null, tracks: [], links: [],
      ringed: new Set(), anchors: new Set(), pointers: [], closer: false, points: [], shown: { walls: true, names: true } });
    this.buttons = make("div", { className: "bar" },
      make("button", { type: "button", click: () => this.zoomBy(1.5), ariaLabel: "zoom in" }, "+"),
      make("button", { type: "button", click: () => this.zoomBy(1 / 1.5), ariaLabel: "zoom out" }, "−"),
      make("button", { type: "button", click: () => this.fit() }, "all"));
    this.whole = make("button", { type: "button", click: () => this.fit(true) }, "track");
    this.stage = make("div", { className: "stage" });
    this.tip = make("div", { className: "tip" });
    this.legend = make("div", { className: "legend" });
    place.append(this.buttons, this.stage, this.legend);
    this.surface = canvas(this.stage, (width) => this.height(width),
      `${label}. Arrow keys go from intersection to intersection, Enter shows one, plus and minus zoom, 0 shows all.`,
      (...all) => this.paint(...all));
    this.stage.append(this.tip);
    this.listen();
    this.load();
  }

  async load() {
    const { plan } = page;
    const [offsets, points, widths, walls] = await Promise.all([numbersOf("road-offsets", Uint32Array), numbersOf("road-points", Int32Array),
      numbersOf("road-widths", Float32Array), numbersOf("walls", Int32Array)]);
    this.roads = { offsets, points, widths };
    this.walls = walls;
    this.ends = plan.ends;
    this.fit(this.closer);
  }

  // What there is to see, or of it what the tracks are in: low x, low y, high x, high y.
  extent(tracks = false) {
    const box = [Infinity, Infinity, -Infinity, -Infinity];
    const take = (x, y) => { box[0] = Math.min(box[0], x); box[1] = Math.min(box[1], y); box[2] = Math.max(box[2], x); box[3] = Math.max(box[3], y); };
    const { x, y } = this.marks;
    if (!tracks) x.forEach((value, k) => take(value, y[k]));
    if (!tracks && this.roads) for (let i = 0; i < this.roads.points.length; i += 2) take(this.roads.points[i] / 100, this.roads.points[i + 1] / 100);
    for (const track of this.tracks) if (!tracks || !track.hidden) for (let i = 0; i < track.x.length; i++) take(track.x[i], track.y[i]);
    for (const point of this.points) take(point.x, point.y);
    if (box[0] > box[2]) return tracks ? this.extent() : [-10, -10, 10, 10];
    return [box[0] - 8, box[1] - 8, box[2] + 8, box[3] + 8];
  }

  height(width) {
    const [x0, y0, x1, y1] = this.extent();
    return Math.min(0.8 * Math.max(300, window.innerHeight), Math.max(240, (width * (y1 - y0)) / (x1 - x0) + 50));
  }

  fit(tracks = false) { this.view = null; this.closer = tracks; this.surface.again(); }

  // The view is what lies in the middle and how many pixels a metre is.
  viewIn(width, height) {
    const [x0, y0, x1, y1] = this.extent(this.closer);
    this.view ??= { x: (x0 + x1) / 2, y: (y0 + y1) / 2, scale: Math.min((width - 60) / (x1 - x0), (height - 44) / (y1 - y0)) };
    this.frame = { left: 54, right: 6, top: 6, bottom: 38, width, height };
    const { left, right, top, bottom } = this.frame;
    this.centre = [(left + width - right) / 2, (top + height - bottom) / 2];
  }
  toScreen(x, y) { return [this.centre[0] + (x - this.view.x) * this.view.scale, this.centre[1] - (y - this.view.y) * this.view.scale]; }
  toWorld(px, py) { return [this.view.x + (px - this.centre[0]) / this.view.scale, this.view.y - (py - this.centre[1]) / this.view.scale]; }

  zoomBy(factor, px = this.centre?.[0], py = this.centre?.[1]) {
    if (!this.view) return;
    const [x, y] = this.toWorld(px, py), scale = Math.min(400, Math.max(0.002, this.view.scale * factor));
    this.view = { scale, x: x - (px - this.centre[0]) / scale, y: y + (py - this.centre[1]) / scale };
    this.surface.again();
  }

  listen() {
    const element = this.surface.element;
    gestures(element, {
      drag: (dx, dy) => { this.view.x -= dx / this.view.scale; this.view.y += dy / this.view.scale; this.surface.again(); },
      pinch: (factor, x, y) => this.zoomBy(factor, x, y),
      tap: (x, y) => { element.focus(); const row = this.nearest(x, y); if (row >= 0) this.pick(row); },
    });
    element.addEventListener("pointermove", (event) => { if (!event.buttons) this.hover(this.nearest(...at(element, event))); });
    element.addEventListener("pointerleave", () => this.hover(-1));
    element.addEventListener("keydown", (event) => {
      const way = { ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, 1], ArrowDown: [0, -1] }[event.key];
      if (way) this.step(way);
      else if (event.key === "+" || event.key === "=") this.zoomBy(1.5);
      else if (event.key === "-") this.zoomBy(1 / 1.5);
      else if (event.key === "0") this.fit();
      else if (event.key === "Enter" && this.hovered >= 0) this.pick(this.hovered);
      else return;
      event.preventDefault();
    });
  }

  nearest(px, py, within = 16) {
    if (!this.view) return -1;
    const { x, y } = this.marks, [wx, wy] = this.toWorld(px, py);
    let best = -1, least = within / this.view.scale;
    for (let k = 0; k < x.length; k++) {
      const off = Math.hypot(x[k] - wx, y[k] - wy);
      if (off < least) { least = off; best = k; }
    }
    return best;
  }

  // To the nearest intersection in a direction.
  step([dx, dy]) {
    const { x, y } = this.marks, from = this.hovered >= 0 ? this.hovered : this.selected;
    if (!x.length) return;
    if (from < 0) { this.hover(0); this.bringIn(0); return; }
    let best = -1, least = Infinity;
    for (let k = 0; k < x.length; k++) {
      const along = (x[k] - x[from]) * dx + (y[k] - y[from]) * dy, off = Math.abs((x[k] - x[from]) * dy) + Math.abs((y[k] - y[from]) * dx);
      if (k !== from && along > 0.5 && off <= 1.5 * along && along + 2 * off < least) { least = along + 2 * off; best = k; }
    }
    if (best >= 0) { this.hover(best); this.bringIn(best); }
  }

  bringIn(row) {
    if (!this.view) return;
    const { x, y } = this.marks, [px, py] = this.toScreen(x[row], y[row]), { left, right, top, bottom, width, height } = this.frame;
    if (px < left + 20 || px > width - right - 20 || py < top + 20 || py > height - bottom - 20) [this.view.x, this.view.y] = [x[row], y[row]];
    this.surface.again();
  }

  hover(row) {
    if (row === this.hovered) return;
    this.hovered = row;
    this.surface.element.style.cursor = row >= 0 ? "pointer" : "";
    this.surface.again();
  }

  select(row) {
    this.selected = row;
    if (row >= 0) this.bringIn(row);
    this.surface.again();
  }

  paint(context, width, height) {
    this.viewIn(width, height);
    const { left, right, top, bottom } = this.frame;
    context.clearRect(0, 0, width, height);
    context.save();
    context.beginPath();
    context.rect(left, top, width - left - right, height - top - bottom);
    context.clip();
    this.paintMine(context, width, height);
    for (const track of this.tracks) if (!track.hidden) this.paintTrack(context, track);
    this.paintLinks(context);
    this.paintMarks(context, width, height);
    this.paintPoints(context);
    for (const pointer of this.pointers) this.paintPointer(context, pointer);
    context.restore();
    this.paintAxes(context, width, height);
    this.placeTip();
  }

  paintMine(context, width, height) {
    if (!this.roads) return;
    const { offsets, points, widths } = this.roads, { scale } = this.view;
    context.lineJoin = context.lineCap = "round";
    const line = (k) => {
      for (let i = offsets[k]; i < offsets[k + 1]; i++) {
        const [px, py] = this.toScreen(points[2 * i] / 100, points[2 * i + 1] / 100);
        if (i === offsets[k]) context.moveTo(px, py); else context.lineTo(px, py);
      }
    };
    // as wide as they are, where that can be seen, and the axis in the middle
    context.strokeStyle = colours.band;
    for (let k = 0; k + 1 < offsets.length; k++) {
      if (widths[k] * scale < 2) continue;
      context.lineWidth = widths[k] * scale;
      context.beginPath(); line(k); context.stroke();
    }
    if (this.shown.walls) {
      context.fillStyle = colours.wall;
      for (let i = 0; i < this.walls.length; i += 2) {
        const [px, py] = this.toScreen(this.walls[i] / 100, this.walls[i + 1] / 100);
        if (px > 0 && py > 0 && px < width && py < height) context.fillRect(px, py, 1, 1);
      }
    }
    context.strokeStyle = colours.faint;
    context.lineWidth = 1;
    context.beginPath();
    for (let k = 0; k + 1 < offsets.length; k++) line(k);
    context.stroke();
    context.fillStyle = colours.faint;
    for (const [x, y] of this.ends) { const [px, py] = this.toScreen(x, y); context.fillRect(px - 2, py - 2, 4, 4); }
  }

  paintTrack(context, { x, y, colour, shades, dashed, gaps }) {
    context.lineWidth = shades ? 3 : 1.8;
    context.setLineDash(dashed ? [5, 4] : []);
    let now = null;
    for (let k = 0; k < x.length; k++) {
      const [px, py] = this.toScreen(x[k], y[k]), wanted = shades ? shades[k] : colour, gap = k === 0 || gaps?.[k];
      if (wanted !== now || gap) {
        if (now !== null) { if (!gap) context.lineTo(px, py); context.stroke(); }
        context.beginPath();
        context.moveTo(px, py);
        context.strokeStyle = now = wanted;
      } else context.lineTo(px, py);
    }
    if (x.length) context.stroke();
    context.setLineDash([]);
  }

  paintLinks(context) {
    const { x, y } = this.marks;
    context.strokeStyle = colours.proven;
    context.lineWidth = 1.5;
    context.setLineDash([6, 4]);
    for (const [a, b] of this.links) {
      context.beginPath();
      context.moveTo(...this.toScreen(x[a], y[a]));
      context.lineTo(...this.toScreen(x[b], y[b]));
      context.stroke();
    }
    context.setLineDash([]);
  }

  paintMarks(context, width, height) {
    const { id, x, y, kind } = this.marks, size = Math.min(1, Math.max(0.25, this.view.scale * 4 / 6));
    const inside = [];
    for (let k = 0; k < x.length; k++) {
      const [px, py] = this.toScreen(x[k], y[k]);
      if (px > -20 && py > -20 && px < width + 20 && py < height + 20) inside.push([k, px, py]);
    }
    const shapes = {};
    for (const [k, px, py] of inside) {
      const shape = shapes[kind[k]] ??= new Path2D(kindPath(kind[k], 7 * size));
      context.save();
      context.translate(px, py);
      context.fillStyle = colours.kinds[kind[k]] ?? colours.faint;
      context.fill(shape);
      context.restore();
      if (this.ringed.has(k)) this.ring(context, px, py, 11 * size, colours.proven, 2);
      if (this.anchors.has(k)) this.ring(context, px, py, 14 * size, colours.anchor, 3 * size);
      if (k === this.selected) this.ring(context, px, py, 17, colours.ink, 2.5);
      else if (k === this.hovered) this.ring(context, px, py, 17, colours.faint, 2);
    }
    if (!this.shown.names || inside.length > 160) return;
    context.fillStyle = colours.ink;
    context.strokeStyle = "#fff";
    context.lineWidth = 3;
    context.font = "12px system-ui, sans-serif";
    context.textAlign = "left";
    for (const [k, px, py] of inside) {
      context.strokeText(id[k], px + 9, py - 7);
      context.fillText(id[k], px + 9, py - 7);
    }
  }

  ring(context, px, py, r, colour, width) {
    context.beginPath();
    context.arc(px, py, r, 0, 2 * Math.PI);
    context.strokeStyle = colour;
    context.lineWidth = width;
    context.stroke();
  }

  paintPoints(context) {
    for (const { x, y, colour, kind } of this.points) {
      const [px, py] = this.toScreen(x, y);
      context.save();
      context.translate(px, py);
      context.fillStyle = colour;
      context.fill(new Path2D(kindPath(kind, 5)));
      context.restore();
    }
    if (this.points.length > 60) return;
    context.fillStyle = colours.faint;
    context.font = "11px system-ui, sans-serif";
    context.textAlign = "center";
    for (const { x, y, name } of this.points) {
      const [px, py] = this.toScreen(x, y);
      context.fillText(name, px, py - 8);
    }
  }

  // Where a robot is at the time that is pointed at.
  paintPointer(context, { x, y, yaw, colour }) {
    context.save();
    context.translate(...this.toScreen(x, y));
    context.rotate(-yaw);
    context.fillStyle = colour;
    context.strokeStyle = "#fff";
    context.lineWidth = 1.5;
    const arrow = new Path2D("M12 0L-7 7L-3 0L-7 -7Z");
    context.fill(arrow);
    context.stroke(arrow);
    context.restore();
  }

  paintAxes(context, width, height) {
    const { left, right, top, bottom } = this.frame, [ox, oy] = page.plan.origin;
    const [x0, y1] = this.toWorld(left, top), [x1, y0] = this.toWorld(width - right, height - bottom);
    context.strokeStyle = context.fillStyle = colours.faint;
    context.lineWidth = 1;
    context.strokeRect(left, top, width - left - right, height - top - bottom);
    context.font = "11px system-ui, sans-serif";
    context.textAlign = "center";
    const wide = String(Math.round(Math.abs(ox) + 1000)).length * 7 + 24, across = ticks(x0 + ox, x1 + ox, (width - left) / Math.max(70, wide));
    for (const value of across.values) {
      const [px] = this.toScreen(value - ox, 0);
      context.fillRect(px, height - bottom, 1, 4);
      if (px < width - wide / 2 && px > left + 8) context.fillText(tickText(value, across.step), px, height - bottom + 15);
    }
    context.fillText("x [m]", (left + width) / 2, height - 5);
    const up = ticks(y0 + oy, y1 + oy, height / 60);
    context.textAlign = "center";
    for (const value of up.values) {
      const [, py] = this.toScreen(0, value - oy);
      context.fillRect(left - 4, py, 4, 1);
      // long numbers of a mine grid stand upright
      context.save();
      context.translate(left - 9, py);
      context.rotate(-Math.PI / 2);
      if (py > top + 24 && py < height - bottom - 24) context.fillText(tickText(value, up.step), 0, 0);
      context.restore();
    }
    context.save();
    context.translate(12, (top + height - bottom) / 2);
    context.rotate(-Math.PI / 2);
    context.fillText("y [m]", 0, 0);
    context.restore();
  }

  placeTip() {
    const row = this.hovered, { x, y } = this.marks;
    this.tip.style.display = row >= 0 ? "block" : "none";
    if (row < 0) return;
    const [px, py] = this.toScreen(x[row], y[row]);
    this.tip.textContent = this.describe(row);
    this.tip.style.left = `${Math.min(Math.max(px, 80), this.frame.width - 80)}px`;
    this.tip.style.top = `${Math.max(py, 44)}px`;
  }

  describe(row) {
    const { id, kind, quality, branches } = this.marks;
    return `${id[row]}: ${kind[row]}, ${branches[row].length} roadways, quality ${quality[row].toFixed(2)}`;
  }

  // Entries of the legend for surveyed points: one a sort.
  pointKinds() {
    return [...new Map(this.points.map(({ sort, kind, colour }) => [sort, [kind, colour, sort]])).values()];
  }

  // kinds that occur, and more entries: [mark, colour, words]
  tell(more = []) {
    const kinds = [...new Set(this.marks.kind)].sort().map((kind) => [kind, colours.kinds[kind] ?? colours.faint, `${kind} intersection`]);
    this.legend.replaceChildren(...[...kinds, ...more].map(([kind, colour, words]) => make("span", {}, mark(kind, colour), words)));
  }
}
