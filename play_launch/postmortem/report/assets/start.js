// Puts it together: first what is seen first.

function fitToScrollbar() {
  const rows = byId("rows");
  document.documentElement.style.setProperty("--scrollbar", `${rows.offsetWidth - rows.clientWidth}px`);
  redraw();
}

async function start() {
  startTables();
  if (typeof DecompressionStream === "undefined") throw new Error("this browser is too old: it has no DecompressionStream");
  await loadColumns();
  startTimeline();
  startPlots();
  startFailures();
  startKeys();
  startPrinting();
  new ResizeObserver(fitToScrollbar).observe(byId("timeline-card"));
  fitToScrollbar();
  drawNow();
  requestAnimationFrame(() => setTimeout(() => performance.mark("drawn")));
  // The log is large and further down: the first picture does not wait for it.
  await new Promise((resolve) => setTimeout(resolve));
  await loadLines();
  startLog();
  if (timeline.mark >= 0) showFailure(timeline.mark);
  performance.mark("whole");
  document.documentElement.dataset.ready = "yes";
}

start().catch((error) => {
  byId("failed").hidden = false;
  byId("failed").textContent = `This page cannot be drawn: ${error.message}`;
  throw error;
});
