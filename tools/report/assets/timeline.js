// Tracks with their times, and the time that is pointed at: a line in every figure over time, an arrow on the plan.

function loadTracks() {
  return Promise.all(page.tracks.map(async (track) => {
    const [times, poses] = await Promise.all([numbersOf(`track-${track.name}-time`, Float32Array), numbersOf(`track-${track.name}-pose`, Float32Array)]);
    const count = times.length, x = new Float32Array(count), y = new Float32Array(count), gaps = new Uint8Array(count);
    for (let k = 0; k < count; k++) {
      [x[k], y[k]] = [poses[4 * k], poses[4 * k + 1]];
      gaps[k] = k > 0 && times[k] - times[k - 1] > Math.max(1, 3 * (times[count - 1] - times[0]) / count);
    }
    return { ...track, times, poses, x, y, gaps, hidden: Boolean(track.hidden) };
  }));
}

// A box to tick for each track of a plan.
function trackBoxes(plan, tracks, changed) {
  for (const track of tracks)
    plan.buttons.append(make("label", {}, make("input", { type: "checkbox", checked: !track.hidden,
      change: (event) => { track.hidden = !event.target.checked; changed(); } }), track.title));
}

class Timeline {
  // Arrows go along the tracks in \`pointed\`, in a colour each.
  constructor(plan, pointed) {
    Object.assign(this, { plan, pointed });
    this.figures = [...document.querySelectorAll("[data-time-axis]")].map((place) => this.figure(place));
  }

  figure(place) {
    const [left, right, first, last] = place.dataset.timeAxis.split(" ").map(Number), line = make("div", { className: "cursor" });
    line.hidden = true;
    place.append(line);
    place.addEventListener("pointermove", (event) => {
      const box = place.querySelector("svg").getBoundingClientRect();
      this.pointAt(first + ((event.clientX - box.left) / box.width - left) / (right - left) * (last - first));
    });
    return { place, line, left, right, first, last };
  }

  pointAt(time) {
    for (const { place, line, left, right, first, last } of this.figures) {
      const share = left + ((time - first) / (last - first)) * (right - left), { width } = place.querySelector("svg").getBoundingClientRect();
      line.hidden = share < left || share > right;
      line.style.left = `${share * width}px`;
    }
    this.plan.pointers = this.pointed.filter(({ track }) => track.times.length && !track.hidden).map(({ track, colour }) => {
      const k = firstFrom(track.times, time);
      return { x: track.poses[4 * k], y: track.poses[4 * k + 1], yaw: track.poses[4 * k + 3], colour };
    });
    this.plan.surface.again();
  }
}

// Index of the first of ascending numbers that is not below a value, or of the last one.
function firstFrom(values, value) {
  let low = 0, high = values.length - 1;
  while (low < high) {
    const middle = (low + high) >> 1;
    if (values[middle] < value) low = middle + 1; else high = middle;
  }
  return low;
}
