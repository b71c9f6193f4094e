// Point clouds in three dimensions, drawn point by point with a depth buffer: needs no graphics card and no library.

class CloudView {
  constructor(place, label) {
    this.stage = make("div", { className: "stage" });
    this.legend = make("div", { className: "legend" });
    place.replaceChildren(this.stage, this.legend);
    this.clouds = [];
    this.reset();
    this.surface = canvas(this.stage, (width) => Math.min(420, 0.75 * width),
      `${label}. Arrow keys turn, plus and minus zoom, 0 resets.`, (...all) => this.paint(...all));
    const element = this.surface.element;
    gestures(element, {
      drag: (dx, dy, event) => (event.shiftKey ? this.shift(dx, dy) : this.turn(-0.008 * dx, 0.008 * dy)),
      pinch: (factor) => this.zoomBy(factor),
      tap: () => element.focus(),
    });
    element.addEventListener("keydown", (event) => {
      const step = 0.12, act = {
        ArrowLeft: () => this.turn(step, 0), ArrowRight: () => this.turn(-step, 0),
        ArrowUp: () => this.turn(0, step), ArrowDown: () => this.turn(0, -step),
        "+": () => this.zoomBy(1.25), "=": () => this.zoomBy(1.25), "-": () => this.zoomBy(0.8),
        0: () => { this.reset(); this.surface.again(); },
      }[event.key];
      if (!act) return;
      event.preventDefault();
      act();
    });
  }

  reset() { [this.yaw, this.tilt, this.zoom, this.pan] = [0.6, 0.9, 1, [0, 0]]; }
  turn(yaw, tilt) { this.yaw += yaw; this.tilt = Math.min(1.57, Math.max(0, this.tilt + tilt)); this.surface.again(); }
  shift(dx, dy) { this.pan = [this.pan[0] + dx, this.pan[1] + dy]; this.surface.again(); }
  zoomBy(factor) { this.zoom = Math.min(40, Math.max(0.3, this.zoom * factor)); this.surface.again(); }

  // clouds: [{points, colour: "#rrggbb" or null for heights, name}], in metres about a common origin.
  show(clouds) {
    this.clouds = clouds.filter((cloud) => cloud.points.length);
    let low = [Infinity, Infinity, Infinity], high = [-Infinity, -Infinity, -Infinity];
    for (const { points } of this.clouds)
      for (let i = 0; i < points.length; i++) {
        low[i % 3] = Math.min(low[i % 3], points[i]);
        high[i % 3] = Math.max(high[i % 3], points[i]);
      }
    if (!this.clouds.length) [low, high] = [[0, 0, 0], [0, 0, 0]];
    this.low = low; this.high = high;
    this.middle = low.map((value, k) => (value + high[k]) / 2);
    this.size = Math.max(1, Math.hypot(...low.map((value, k) => high[k] - value)));
    const entries = this.clouds.map(({ name, colour, points }) => colour
      ? make("span", {}, mark("dot", colour), `${name}, ${points.length / 3} points`)
      : make("span", {}, `${name}, ${points.length / 3} points, height`, scaleLegend(short(low[2]), short(high[2]), "m")));
    this.legend.replaceChildren(...(entries.length ? entries : ["No points to show."]));
    this.surface.again();
  }

  paint(context, width, height) {
    const sharp = window.devicePixelRatio || 1, w = Math.round(width * sharp), h = Math.round(height * sharp);
    const image = context.createImageData(w, h), pixels = new Uint32Array(image.data.buffer);
    const depth = new Float32Array(w * h).fill(-Infinity);
    pixels.fill(0xffffffff);
    const scale = (this.zoom * 1.02 * Math.min(w, h * 1.4)) / (this.size || 1), dot = Math.max(1, Math.round(sharp * (this.zoom > 2 ? 2 : 1.5)));
    const [cy, sy, ct, st] = [Math.cos(this.yaw), Math.sin(this.yaw), Math.cos(this.tilt), Math.sin(this.tilt)];
    const [ox, oy] = [w / 2 + this.pan[0] * sharp, h / 2 + this.pan[1] * sharp], span = Math.max(1e-6, (this.high?.[2] ?? 1) - (this.low?.[2] ?? 0));
    for (const { points, colour } of this.clouds) {
      const fixed = colour ? rgb(colour) : null;
      for (let i = 0; i < points.length; i += 3) {
        const x = points[i] - this.middle[0], y = points[i + 1] - this.middle[1], z = points[i + 2] - this.middle[2];
        const right = cy * x + sy * y, ahead = -sy * x + cy * y;
        // seen from above by the tilt: 0 is from the side, a quarter turn straight down
        const up = ct * z + st * ahead, near = st * z - ct * ahead;
        const px = Math.round(ox + scale * right), py = Math.round(oy - scale * up);
        if (px < 0 || py < 0 || px >= w - dot || py >= h - dot) continue;
        const [r, g, b] = fixed ?? shade((points[i + 2] - this.low[2]) / span);
        // what is farther off is paler
        const fade = Math.min(0.55, Math.max(0, 0.28 - near / this.size * 0.6)), mix = (c) => Math.round(c + (255 - c) * fade);
        const value = (0xff000000 | (mix(b) << 16) | (mix(g) << 8) | mix(r)) >>> 0;
        for (let dy = 0; dy < dot; dy++)
          for (let dx = 0; dx < dot; dx++) {
            const k = (py + dy) * w + px + dx;
            if (near > depth[k]) { depth[k] = near; pixels[k] = value; }
          }
      }
    }
    context.putImageData(image, 0, 0);
    this.ruler(context, width, height, scale / sharp);
  }

  // How long metres are, and which way is up and north-of-the-grid (+y).
  ruler(context, width, height, scale) {
    const { step } = ticks(0, (0.3 * width) / scale, 1);
    context.strokeStyle = context.fillStyle = colours.ink;
    context.lineWidth = 1.5;
    context.beginPath();
    context.moveTo(12, height - 12); context.lineTo(12 + step * scale, height - 12);
    context.stroke();
    context.font = "12px system-ui, sans-serif";
    context.textAlign = "left";
    context.fillText(`${step} m`, 12, height - 18);
    const [cx, cy] = [width - 38, height - 34], axes = [["x", 1, 0, 0], ["y", 0, 1, 0], ["z", 0, 0, 1]];
    for (const [name, x, y, z] of axes) {
      const right = Math.cos(this.yaw) * x + Math.sin(this.yaw) * y, ahead = -Math.sin(this.yaw) * x + Math.cos(this.yaw) * y;
      const up = Math.cos(this.tilt) * z + Math.sin(this.tilt) * ahead;
      context.beginPath();
      context.moveTo(cx, cy); context.lineTo(cx + 22 * right, cy - 22 * up);
      context.stroke();
      context.fillText(name, cx + 28 * right - 3, cy - 28 * up + 4);
    }
  }
}
