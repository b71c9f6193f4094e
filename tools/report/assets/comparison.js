// The page that compares runs: all of them on one plan, and where each was at the time pointed at.

(async () => {
  const plan = new PlanView(byId("plan"), { label: "Plan of the mine and the runs", pick: (row) => plan.select(row) });
  const tracks = await loadTracks();
  plan.points = page.points;
  plan.tracks = [...tracks].reverse();
  if (tracks.length) plan.buttons.append(plan.whole);
  const tell = () => {
    plan.tell([...tracks.filter((track) => !track.hidden).map(({ title, colour, dashed }) => ["dot", colour, title + (dashed ? " (dashed)" : "")]), ...plan.pointKinds()]);
    plan.surface.again();
  };
  trackBoxes(plan, tracks, tell);
  tell();
  plan.fit(tracks.length > 0);
  new Timeline(plan, tracks.map((track) => ({ track, colour: track.colour })));
  document.body.dataset.ready = "yes";
})();
