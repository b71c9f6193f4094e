// The page about a run: what was seen at each intersection, and where the robot was at the time pointed at.

(async () => {
  const all = page.intersections, rowOf = new Map(all.id.map((id, row) => [id, row]));
  const plan = new PlanView(byId("plan"), { label: "Plan of the mine and the run", pick: (row) => pickPlace(row) });
  plan.ringed = new Set(page.recognised.map((id) => rowOf.get(id)).filter((row) => row !== undefined));
  plan.points = page.points;
  const cloud = new CloudView(byId("cloud"), "What the robot saw, laid over the database");
  let picked = -1, table = null;

  const tracks = await loadTracks();
  const main = tracks[0];
  plan.tracks = [...tracks].reverse();

  // Which tracks are shown, and by what the main one is coloured.
  if (main) plan.buttons.append(plan.whole);
  trackBoxes(plan, tracks, () => tell());
  if (main && page.tints.length) {
    const choose = make("select", { ariaLabel: "colour of the track", change: () => tint(Number(choose.value)) },
      ...page.tints.map(({ name }, k) => make("option", { value: String(k) }, name)), make("option", { value: "-1" }, "nothing"));
    plan.buttons.append(make("label", {}, `${main.title} by`, choose));
    await tint(0);
  } else tell();
  plan.fit(Boolean(main));

  async function tint(k) {
    const told = page.tints[k];
    main.shades = null;
    main.told = told;
    if (told?.bands) {
      let now = 0;
      main.shades = Array.from(main.times, (time) => {
        while (now + 1 < told.bands.length && time >= told.bands[now + 1][0]) now++;
        return told.colours[told.bands[now][2]];
      });
    } else if (told) {
      const errors = await numbersOf("errors", Float32Array);
      main.shades = Array.from(errors, (error) => (Number.isNaN(error) ? colours.line : css(shade(error / told.most))));
    }
    tell();
  }

  function tell() {
    const entries = tracks.filter((track) => !track.hidden && !track.shades).map(({ title, colour, dashed }) => ["dot", colour, title + (dashed ? " (dashed)" : "")]);
    if (plan.ringed.size) entries.push(["dot", colours.proven, "ring: recognised"]);
    plan.tell([...entries, ...plan.pointKinds()]);
    const told = main?.told, place = byId("tinted");
    if (told?.bands) place.replaceChildren(`${main.title} by ${told.name}:`, ...[...new Set(told.bands.map((band) => band[2]))]
      .map((name) => make("span", {}, mark("dot", told.colours[name]), name)));
    else if (told) place.replaceChildren(`${main.title} by `, scaleLegend("0", short(told.most), `m ${told.name}`));
    else place.replaceChildren();
    plan.surface.again();
  }

  const timeline = new Timeline(plan, main ? [{ track: main, colour: colours.proven }] : []);

  async function show(k) {
    picked = k;
    const event = page.events[k], row = rowOf.get(event.id);
    byId("which").textContent = event.id === null ? `Seen at ${event.time.toFixed(1)} s` : `Intersection ${event.id} at ${event.time.toFixed(1)} s`;
    byId("reason").textContent = `${event.accepted ? "Accepted" : "Refused"}: ${event.reason}`;
    const rows = [["on the map by ICP (fit)", share(event.fit)], ["likeness of the rock", share(event.likeness)], ["likeness of the runner-up", share(event.runner_up_likeness)],
      ["distance of the points that fit", event.icp_distance_m === null ? "–" : `${(100 * event.icp_distance_m).toFixed(1)} cm`],
      ["keyframe", event.keyframe], ["keyframes in a row", event.consecutive], ["pins", event.pins.length ? `${event.pins.length}, of ${[...new Set(event.pins)].join(", ")}` : "none"]];
    byId("figures").replaceChildren(...rows.flatMap(([name, value]) => [make("dt", {}, name), make("dd", {}, String(value))]));
    byId("candidates").replaceChildren();
    if (event.candidates.length)
      new DataTable(byId("candidates"), { label: "candidates", columns: ["candidate", "PWCV", "CWC"].map((name) => ({ name })), rows: event.candidates });
    history.replaceState(null, "", `#${k}`);
    plan.select(row ?? -1);
    timeline.pointAt(event.time);
    if (table) table.mark(k);
    const clouds = [];
    if (event.overlay !== null) {
      const stored = page.cloud_of[event.id];
      if (stored !== undefined) clouds.push({ points: await cloudOf("cloud", page.clouds, stored), colour: colours.map_cloud, name: "database" });
      clouds.push({ points: await cloudOf("seen", page.seen, event.overlay), colour: colours.live_cloud, name: "keyframes, by ICP" });
    }
    if (picked === k) cloud.show(clouds);
    byId("detail").dataset.event = k;
  }
  const share = (value) => (value === null ? "–" : value.toFixed(3));

  // Of an intersection on the plan: its next event, the accepted ones first.
  function pickPlace(row) {
    const mine = page.events.map((event, k) => [event, k]).filter(([event]) => event.id === all.id[row]);
    const order = [...mine.filter(([event]) => event.accepted), ...mine.filter(([event]) => !event.accepted)].map(([, k]) => k);
    if (order.length) show(order[(order.indexOf(picked) + 1) % order.length]);
    else {
      picked = -1;
      plan.select(row);
      byId("which").textContent = `Intersection ${all.id[row]}`;
      byId("reason").textContent = "The run compared nothing with it.";
      for (const id of ["figures", "candidates"]) byId(id).replaceChildren();
      cloud.show([]);
      byId("detail").dataset.event = -1;
    }
    if (byId("detail").getBoundingClientRect().top > 0.8 * window.innerHeight) byId("detail").scrollIntoView();
  }

  if (page.events.length) {
    const place = byId("sights"), kind = make("select", { ariaLabel: "which events", change: () => keep() },
      ...["compared by ICP", "accepted", "refused", "all"].map((name) => make("option", { value: name }, name)));
    place.append(make("div", { className: "bar" }, make("label", {}, "show", kind)));
    if (page.events_left_out) place.append(make("p", { className: "note" }, `${page.events_left_out} later events are in events.jsonl only.`));
    table = new DataTable(place, { label: "intersections seen", pick: (k) => { show(k); byId("detail").scrollIntoView({ block: "nearest" }); },
      columns: [{ name: "time [s]" }, { name: "id" }, { name: "accepted" }, { name: "fit" }, { name: "likeness" }, { name: "runner-up" }, { name: "ICP distance [m]" },
        { name: "best PWCV" }, { name: "CWC" }, { name: "in a row" }, { name: "reason", text: true }],
      rows: page.events.map((e) => [e.time, e.id, e.accepted, e.fit, e.likeness, e.runner_up_likeness, e.icp_distance_m, e.candidates[0]?.[1] ?? null,
        e.candidates[0]?.[2] ?? null, e.consecutive, e.reason]) });
    const keep = () => table.keep((k) => {
      const event = page.events[k], compared = event.overlay !== null || event.fit !== null;
      return { accepted: event.accepted, refused: compared && !event.accepted, "compared by ICP": compared, all: true }[kind.value];
    });
    keep();
    const step = (by) => {
      const k = table.order.indexOf(picked), next = table.order[(k + by + table.order.length) % table.order.length];
      if (next !== undefined) show(next);
    };
    byId("before").addEventListener("click", () => step(-1));
    byId("after").addEventListener("click", () => step(1));
    const wanted = location.hash ? Number(location.hash.slice(1)) : page.events.findIndex((event) => event.accepted);
    if (page.events[wanted]) await show(wanted);
    else cloud.show([]);
  } else {
    byId("detail").classList.add("hidden");
    document.querySelector(".main").classList.remove("main");
  }

  for (const { kind, columns, words, rows } of page.tables) {
    const fold = make("details", {}, make("summary", {}, `${kind.replaceAll("_", " ")} (${rows.length})`));
    new DataTable(fold, { label: kind, columns: columns.map((name, k) => ({ name, text: words[k] })), rows });
    byId("others").append(fold);
  }
  document.body.dataset.ready = "yes";
})();
