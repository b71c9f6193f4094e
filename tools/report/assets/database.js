// The page about a semantic database: pick an intersection, or two to compare.

(async () => {
  const all = page.intersections, count = all.id.length, rowOf = new Map(all.id.map((id, row) => [id, row]));
  const radius = page.contour.radius, sectors = page.contour.sectors, layers = page.contour.layers;
  const alike = new Map();
  page.pairs.forEach((pair, k) => { for (const row of [pair.a, pair.b]) alike.set(row, [...(alike.get(row) ?? []), k]); });

  const plan = new PlanView(byId("plan"), { label: "Plan of the mine", pick: (row) => { show(row); intoView(); } });
  const cloud = new CloudView(byId("cloud"), "Point cloud of the intersection");
  let shown = -1, table = null, pairTable = null;

  // Where the screen is too narrow for both, from the plan to what was picked on it.
  const intoView = () => { if (byId("detail").getBoundingClientRect().top > 0.8 * window.innerHeight) byId("detail").scrollIntoView(); };

  const contourOf = async (name, row, size) => {
    const bytes = await numbersOf(`${name}-${Math.floor(row / page.batch)}`, Uint8Array), start = (row % page.batch) * size;
    return bytes.subarray(start, start + size);
  };

  async function show(row, { other = null } = {}) {
    shown = row;
    plan.select(row);
    const pair = other;
    plan.links = pair ? [[pair.a, pair.b]] : (alike.get(row) ?? []).slice(0, 40).map((k) => [page.pairs[k].a, page.pairs[k].b]);
    history.replaceState(null, "", pair ? `#${all.id[pair.a]},${all.id[pair.b]}` : `#${all.id[row]}`);
    byId("chosen").value = all.id[row];
    byId("which").textContent = pair
      ? `Intersections ${all.id[pair.a]} and ${all.id[pair.b]}, the first turned onto the second by ${short(pair.yaw * 180 / Math.PI)}°`
      : `Intersection ${all.id[row]}`;
    byId("figures").replaceChildren(...facts(row, pair));
    if (table) table.mark(row);
    await (pair ? drawPair(pair) : drawOne(row));
    byId("detail").dataset.row = row;
  }

  function facts(row, pair) {
    const degrees = all.branches[row].map((b, k) => `${Math.round(b)}° (${short(all.widths[row][k])} m wide)`).join(", ");
    const rows = pair ? [["PWCV similarity", pair.pwcv.toFixed(3)], ["CWC similarity", pair.cwc.toFixed(3)],
      ["rock, likeness after ICP", pair.rock === null ? "not compared" : pair.rock.toFixed(3)],
      ["intersections until the order tells", pair.passed === null ? "it never does" : pair.passed], ["told apart by", pair.told]]
      : [["type", all.kind[row]], ["roadways leave at", degrees || "–"],
        ["place x, y, z", [0, 1].map((k) => ((k ? all.y : all.x)[row] + page.plan.origin[k]).toFixed(2)).concat(all.z[row].toFixed(2)).join("  ") + " m"],
        ["walls seen at", `${short(all.nearest[row])} to ${short(all.farthest[row])} m, median ${short(all.median[row])} m`],
        ["clear height", all.height[row] ? `${short(all.height[row])} m` : "not known"],
        ["quality", all.quality[row].toFixed(2)], ["points kept", String(all.points[row])],
        ["looks like", (alike.get(row) ?? []).slice(0, 12).map((k) => all.id[page.pairs[k].a === row ? page.pairs[k].b : page.pairs[k].a]).join(", ") || "no other"]];
    return rows.flatMap(([name, value]) => [make("dt", {}, name), make("dd", {}, String(value))]);
  }

  async function drawOne(row) {
    const [pwcv, cwc, points] = await Promise.all([contourOf("pwcv", row, sectors), contourOf("cwc", row, sectors * layers), cloudOf("cloud", page.clouds, row)]);
    if (shown !== row) return;
    byId("polar").replaceChildren(polarPlot([{ pwcv, colour: colours.contour }], all.branches[row], radius, `PWCV of intersection ${all.id[row]}`));
    unrolledImage(byId("unrolled"), cwc, sectors, page.contour, radius, `CWC of intersection ${all.id[row]}`);
    byId("second").replaceChildren();
    cloud.show([{ points, colour: null, name: `intersection ${all.id[row]}` }]);
  }

  async function drawPair({ a, b, yaw }) {
    const [one, other, cwc, below, points, mates] = await Promise.all([contourOf("pwcv", a, sectors), contourOf("pwcv", b, sectors),
      contourOf("cwc", a, sectors * layers), contourOf("cwc", b, sectors * layers), cloudOf("cloud", page.clouds, a), cloudOf("cloud", page.clouds, b)]);
    const turned = new Float32Array(points), [c, s] = [Math.cos(yaw), Math.sin(yaw)];
    for (let i = 0; i < points.length; i += 3) {
      turned[i] = c * points[i] - s * points[i + 1];
      turned[i + 1] = s * points[i] + c * points[i + 1];
    }
    byId("polar").replaceChildren(polarPlot([{ pwcv: one, colour: colours.map_cloud, turn: yaw }, { pwcv: other, colour: colours.live_cloud }],
      [], radius, `PWCV of intersections ${all.id[a]} and ${all.id[b]}`));
    const shift = Math.round((yaw / (2 * Math.PI)) * sectors), rolled = new Uint8Array(cwc.length);
    for (let k = 0; k < cwc.length; k++) {
      const layer = Math.floor(k / sectors), sector = k % sectors;
      rolled[layer * sectors + ((((sector + shift) % sectors) + sectors) % sectors)] = cwc[k];
    }
    unrolledImage(byId("unrolled"), rolled, sectors, page.contour, radius, `CWC of intersection ${all.id[a]}, turned`);
    unrolledImage(byId("second"), below, sectors, page.contour, radius, `CWC of intersection ${all.id[b]}`);
    cloud.show([{ points: turned, colour: colours.map_cloud, name: `intersection ${all.id[a]}, turned` },
      { points: mates, colour: colours.live_cloud, name: `intersection ${all.id[b]}` }]);
  }

  function pairOf(a, b) {
    const [low, high] = a < b ? [a, b] : [b, a];
    return (alike.get(low) ?? []).map((k) => page.pairs[k]).find((pair) => pair.a === low && pair.b === high);
  }

  async function matrices() {
    const { rows } = page.matrix, names = rows.map((row) => String(all.id[row]));
    for (const [name, title] of [["pwcv", "PWCV"], ["cwc", "CWC"]]) {
      const values = await numbersOf(`matrix-${name}`, Uint8Array);
      new MatrixView(byId(`matrix-${name}`), { title, values, names, pick: (a, b) => {
        const pair = pairOf(rows[a], rows[b]);
        if (pair) show(pair.a, { other: pair }); else show(rows[a]);
        byId("detail").scrollIntoView({ block: "start" });
      } });
    }
  }

  function levels() {
    const choose = byId("level"), told = byId("anchors");
    if (!choose) return;
    const pick = () => {
      const level = page.levels[choose.value];
      plan.anchors = new Set(level.anchors.map((id) => rowOf.get(id)));
      told.textContent = level.anchors.length ? level.anchors.slice(0, 200).join(", ") + (level.anchors.length > 200 ? ", …" : "") : "none needed";
      const kept = new Set(level.pairs);
      pairTable?.keep((k) => kept.has(k));
      plan.tell([["dot", colours.proven, "dashed: look alike"], ["dot", colours.anchor, "ring: anchor proposed"], ["L", colours.faint, "end or bend of a roadway"]]);
      plan.surface.again();
    };
    choose.addEventListener("change", pick);
    pick();
  }

  const cell = (row) => [all.id[row], all.kind[row], Number((all.x[row] + page.plan.origin[0]).toFixed(2)), Number((all.y[row] + page.plan.origin[1]).toFixed(2)),
    all.z[row], all.branches[row].map((b) => Math.round(b)).join(" "), all.widths[row].join(" "), all.quality[row], all.points[row]];
  table = new DataTable(byId("table"), { label: "intersections", pick: (row) => { show(row); byId("detail").scrollIntoView({ block: "nearest" }); },
    columns: ["id", "type", "x [m]", "y [m]", "z [m]", "roadways [°]", "widths [m]", "quality", "points"].map((name) => ({ name })),
    rows: all.id.map((_, row) => cell(row)) });
  if (page.pairs.length)
    pairTable = new DataTable(byId("pairs"), { label: "pairs that look alike", pick: (k) => { const pair = page.pairs[k]; show(pair.a, { other: pair }); byId("detail").scrollIntoView({ block: "nearest" }); },
      columns: [{ name: "intersections", text: true }, { name: "PWCV" }, { name: "CWC" }, { name: "rock (ICP)" }, { name: "passed until told" }, { name: "told apart by", text: true }],
      rows: page.pairs.map((p) => [`${all.id[p.a]} – ${all.id[p.b]}`, p.pwcv, p.cwc, p.rock, p.passed ?? "never", p.told]) });
  byId("chosen").addEventListener("change", (event) => { const row = rowOf.get(Number(event.target.value)); if (row !== undefined) show(row); });
  const step = (by) => count && show((shown + by + count) % count);
  byId("before").addEventListener("click", () => step(-1));
  byId("after").addEventListener("click", () => step(1));
  levels();
  const [first, second] = decodeURIComponent(location.hash.slice(1)).split(",").map((word) => rowOf.get(Number(word)));
  const pair = first !== undefined && second !== undefined ? pairOf(first, second) : null;
  if (count) await show(first ?? 0, { other: pair ?? null });
  if (page.matrix) await matrices();
  document.body.dataset.ready = "yes";
})();
