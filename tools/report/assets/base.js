// What all parts of a page share: its data, its colours, elements, and what is selected.
const page = JSON.parse(document.getElementById("data").textContent);
const colours = page.colours;
const SVG = "http://www.w3.org/2000/svg";

// An element; text only ever comes in as text, never as HTML.
function make(name, attributes = {}, ...children) {
  const element = document.createElement(name);
  for (const [key, value] of Object.entries(attributes)) set(element, key, value);
  element.append(...children);
  return element;
}

function draw(name, attributes = {}, ...children) {
  const element = document.createElementNS(SVG, name);
  for (const [key, value] of Object.entries(attributes)) element.setAttribute(key, value);
  element.append(...children);
  return element;
}

function set(element, key, value) {
  if (typeof value === "function") element.addEventListener(key, value);
  else if (key in element && key !== "list" && key !== "style") element[key] = value;
  else element.setAttribute(key, value);
}

const byId = (id) => document.getElementById(id);

const unpacked = new Map();

// The bytes of a named array as numbers of a type; unpacked once, when first wanted.
function numbersOf(name, Type) {
  if (!unpacked.has(name)) unpacked.set(name, unpack(byId("blob-" + name).textContent).then((bytes) => new Type(bytes)));
  return unpacked.get(name);
}

async function unpack(base64) {
  const text = atob(base64), bytes = new Uint8Array(text.length);
  for (let k = 0; k < text.length; k++) bytes[k] = text.charCodeAt(k);
  const stream = new Blob([bytes]).stream().pipeThrough(new DecompressionStream("gzip"));
  return new Response(stream).arrayBuffer();
}

// Points (x, y, z, x, y, ...) of a packed cloud; see tools/report/pack.py.
async function cloudOf(name, rows, k) {
  const [start, count, ...box] = rows[k];
  const packed = await numbersOf(`${name}-${Math.floor(k / page.batch)}`, Uint32Array);
  const points = new Float32Array(3 * count);
  for (let i = 0; i < count; i++) {
    const bits = packed[start + i];
    for (let axis = 0; axis < 3; axis++) points[3 * i + axis] = box[axis] + box[3 + axis] * ((bits >>> (10 * axis)) & 1023);
  }
  return points;
}

// A colour of the scale for a number in [0, 1].
function shade(value) {
  const scale = page.scale, k = Math.min(scale.length - 1, Math.max(0, Math.round(value * (scale.length - 1))));
  return scale[k];
}
const css = ([r, g, b]) => `rgb(${r},${g},${b})`;
const rgb = (hex) => [1, 3, 5].map((k) => parseInt(hex.slice(k, k + 2), 16));

function scaleLegend(low, high, what) {
  const steps = [0, 0.25, 0.5, 0.75, 1].map((v) => css(shade(v))).join(",");
  const bar = make("i");
  bar.style.background = `linear-gradient(90deg,${steps})`;
  return make("span", { className: "scale" }, low, bar, `${high} ${what}`);
}

function mark(kind, colour, size = 16) {
  const shape = kindPath(kind, 6);
  return draw("svg", { viewBox: "-8 -8 16 16", width: size, height: size, "aria-hidden": "true" },
    draw("path", { d: shape, fill: colour }));
}

// A mark of a kind of intersection about the origin, as an SVG path.
function kindPath(kind, r) {
  const corners = { L: [4, 45, 1], T: [3, -90, 1.15], Y: [3, 90, 1.15], X: [4, 0, 1.1], multi: [10, -90, 1.3] }[kind] ?? [12, 0, 0.9];
  const [n, turn, far] = corners, parts = [];
  for (let k = 0; k < n; k++) {
    const a = (turn + (360 * k) / n) * Math.PI / 180, length = r * far * (kind === "multi" && k % 2 ? 0.5 : 1);
    parts.push(`${(length * Math.cos(a)).toFixed(2)} ${(length * Math.sin(a)).toFixed(2)}`);
  }
  return `M${parts.join("L")}Z`;
}

// A canvas that fills its place, sharp on every screen: calls paint(context, width, height) after sizes change.
function canvas(place, ratio, label, paint) {
  const element = make("canvas", { tabIndex: 0 });
  element.setAttribute("role", "application");
  element.setAttribute("aria-label", label);
  place.append(element);
  let asked = false;
  const again = () => {
    if (asked) return;
    asked = true;
    requestAnimationFrame(() => { asked = false; now(); });
  };
  const now = () => {
    const width = place.clientWidth - 2, height = Math.round(ratio(width)), sharp = window.devicePixelRatio || 1;
    if (width <= 0) return;
    if (element.width !== Math.round(width * sharp) || element.height !== Math.round(height * sharp)) {
      element.width = Math.round(width * sharp);
      element.height = Math.round(height * sharp);
      element.style.height = `${height}px`;
    }
    const context = element.getContext("2d", { willReadFrequently: true });
    context.setTransform(sharp, 0, 0, sharp, 0, 0);
    paint(context, width, height);
  };
  new ResizeObserver(again).observe(place);
  return { element, again, now };
}

// Where a pointer is on an element.
function at(element, event) {
  const box = element.getBoundingClientRect();
  return [event.clientX - box.left, event.clientY - box.top];
}

// Dragging by mouse or one finger, pinching by two, for canvases: drag(dx, dy, event), pinch(factor, x, y), tap(x, y).
function gestures(element, { drag, pinch, tap }) {
  const down = new Map();
  let moved = 0, apart = 0;
  element.addEventListener("pointerdown", (event) => {
    down.set(event.pointerId, [event.clientX, event.clientY]);
    element.setPointerCapture(event.pointerId);
    moved = down.size > 1 ? 99 : 0;
    apart = 0;
  });
  element.addEventListener("pointermove", (event) => {
    const before = down.get(event.pointerId);
    if (!before) return;
    const now = [event.clientX, event.clientY];
    down.set(event.pointerId, now);
    if (down.size === 2) {
      const [a, b] = [...down.values()], gap = Math.hypot(a[0] - b[0], a[1] - b[1]), box = element.getBoundingClientRect();
      if (apart > 0) pinch(gap / apart, (a[0] + b[0]) / 2 - box.left, (a[1] + b[1]) / 2 - box.top);
      apart = gap;
      return;
    }
    moved += Math.abs(now[0] - before[0]) + Math.abs(now[1] - before[1]);
    if (moved > 3) drag(now[0] - before[0], now[1] - before[1], event);
  });
  const up = (event) => {
    if (down.delete(event.pointerId) && event.type === "pointerup" && moved <= 3 && !down.size) tap(...at(element, event));
  };
  element.addEventListener("pointerup", up);
  element.addEventListener("pointercancel", up);
  element.addEventListener("wheel", (event) => {
    if (document.activeElement !== element && !event.ctrlKey) return;
    event.preventDefault();
    pinch(Math.exp(-event.deltaY * 0.0015), ...at(element, event));
  }, { passive: false });
}

// A number for people: three digits that count.
function short(value, digits = 3) {
  if (value === null || value === undefined || Number.isNaN(value)) return "–";
  return Math.abs(value) >= 1000 ? value.toFixed(1) : String(Number(value.toPrecision(digits)));
}

// Steps of an axis between two numbers: round ones, about so many.
function ticks(low, high, about) {
  const raw = (high - low) / Math.max(1, about), power = 10 ** Math.floor(Math.log10(raw));
  const step = [1, 2, 5, 10].map((k) => k * power).find((k) => k >= raw), found = [];
  for (let v = Math.ceil(low / step) * step; v <= high + 1e-9 * step; v += step) found.push(v);
  return { step, values: found };
}
const tickText = (value, step) => value.toFixed(Math.max(0, -Math.floor(Math.log10(step) + 1e-9)));
