// Wall contours: the PWCV as a polar plot, the CWC unrolled.

// Distances of sectors from stored bytes: 0 open, 255 unseen, else 1 to 254 of the radius.
const OPEN = 0, UNSEEN = 255;

function polarPlot(layers, branches, radius, label) {
  const size = 320, c = size / 2, scale = (0.4 * size) / radius;
  const plot = draw("svg", { viewBox: `0 0 ${size} ${size}`, role: "img", "aria-label": label });
  const { values } = ticks(0, radius, 3);
  for (const r of [...values.filter((v) => v > 0 && v < radius), radius]) {
    plot.append(draw("circle", { cx: c, cy: c, r: r * scale, fill: "none", stroke: colours.line }));
    plot.append(draw("text", { x: c + 3, y: c - r * scale + 11, "font-size": 10, fill: colours.faint }, `${short(r)} m`));
  }
  for (let degrees = 0; degrees < 360; degrees += 45) {
    const a = degrees * Math.PI / 180, x = Math.cos(a), y = -Math.sin(a), rim = radius * scale;
    plot.append(draw("line", { x1: c, y1: c, x2: c + rim * x, y2: c + rim * y, stroke: colours.line }));
    plot.append(draw("text", { x: c + (rim + 16) * x, y: c + (rim + 16) * y + 4, "font-size": 10, fill: colours.faint,
      "text-anchor": "middle" }, `${degrees}°`));
  }
  for (const { pwcv, colour, turn = 0 } of layers)
    plot.append(draw("path", { d: contourPath(pwcv, radius, scale, c, turn), fill: colour, "fill-opacity": 0.16, stroke: colour,
      "stroke-width": 1.5, "stroke-linejoin": "round" }));
  for (const bearing of branches) {
    const a = bearing * Math.PI / 180, x = Math.cos(a), y = -Math.sin(a), rim = radius * scale;
    plot.append(draw("line", { x1: c + 0.9 * rim * x, y1: c + 0.9 * rim * y, x2: c + 1.03 * rim * x, y2: c + 1.03 * rim * y,
      stroke: colours.branch, "stroke-width": 5, "stroke-linecap": "round" }));
  }
  return plot;
}

// Free as far as the wall, an open roadway to the rim; what was not seen is left out.
function contourPath(pwcv, radius, scale, c, turn) {
  const n = pwcv.length, parts = [];
  const point = (k, r) => {
    const a = (2 * Math.PI * k) / n + turn;
    return `${(c + r * scale * Math.cos(a)).toFixed(1)} ${(c - r * scale * Math.sin(a)).toFixed(1)}`;
  };
  const whole = pwcv.every((value) => value !== UNSEEN);
  let open = false;
  for (let k = 0; k < n; k++) {
    if (pwcv[k] === UNSEEN) { if (open) parts.push(`L${c} ${c}Z`); open = false; continue; }
    const r = pwcv[k] === OPEN ? radius : (pwcv[k] / 254) * radius;
    parts.push(open ? "L" : whole ? "M" : `M${c} ${c}L`, point(k, r), "L", point(k + 1, r));
    open = true;
  }
  if (open) parts.push("Z");
  return parts.join("");
}

// One row a height layer, upwards; one column a sector, counter-clockwise from x.
function unrolledImage(place, cwc, sectors, shape, radius, label) {
  const layers = cwc.length / sectors, left = 44, bottom = 34, top = 6;
  const stage = make("div", { className: "stage" });
  place.replaceChildren(stage);
  const surface = canvas(stage, () => 26 * layers + bottom + top, label, (context, width, height) => {
    context.clearRect(0, 0, width, height);
    const w = (width - left - 8) / sectors, h = (height - bottom - top) / layers;
    for (let layer = 0; layer < layers; layer++)
      for (let k = 0; k < sectors; k++) {
        const value = cwc[layer * sectors + k];
        if (value === OPEN) continue;
        context.fillStyle = value === UNSEEN ? colours.line : css(shade(value / 254));
        context.fillRect(left + k * w, height - bottom - (layer + 1) * h, w + 0.6, h + 0.6);
      }
    context.strokeStyle = colours.faint;
    context.strokeRect(left, top, sectors * w, layers * h);
    context.fillStyle = colours.faint;
    context.font = "11px system-ui, sans-serif";
    context.textAlign = "center";
    for (let degrees = 0; degrees <= 360; degrees += 90)
      context.fillText(`${degrees}°`, left + (degrees / 360) * sectors * w, height - bottom + 14);
    context.fillText("direction, counter-clockwise from x [°]", left + (sectors * w) / 2, height - 5);
    context.textAlign = "right";
    for (let layer = 0; layer <= layers; layer += Math.max(1, Math.round(layers / 5)))
      context.fillText(short(shape.from + layer * shape.height), left - 5, height - bottom - layer * h + 4);
    context.save();
    context.translate(11, top + (layers * h) / 2);
    context.rotate(-Math.PI / 2);
    context.textAlign = "center";
    context.fillText("height [m]", 0, 0);
    context.restore();
  });
  surface.element.tabIndex = -1;
  surface.element.setAttribute("role", "img");
  place.append(make("div", { className: "legend" }, scaleLegend("0", short(radius), "m to the wall"),
    make("span", {}, mark("L", colours.line), "not seen"), make("span", {}, "white: open roadway")));
}
