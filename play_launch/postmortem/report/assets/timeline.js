// A row for each container, node and process: when it was constructing, loaded, failed or away.

const rowHeight = 17;
const timeline = { shown: [], folds: true, hovered: -1, selected: -1, mark: -1 };

function highlightedRow() {
  return timeline.hovered >= 0 ? timeline.hovered : timeline.selected;
}

function failuresOf(row) {
  return data.marksOfRow[row].length;
}

// Rows in the chosen order; quiet ones are those that never failed.
function arrangeRows() {
  const all = facts.rows.map((_, row) => row);
  const anyFailed = facts.marks.length > 0;
  const isQuiet = (row) => (anyFailed ? failuresOf(row) === 0 : facts.rows[row].kind === "node");
  const quiet = all.filter(isQuiet).length;
  const kept = timeline.folds ? all.filter((row) => !isQuiet(row)) : all;
  if (byId("order").value === "containers") {
    const home = (row) => facts.rows[row].container || facts.rows[row].name;
    const places = new Map();
    for (const row of kept) {
      if (!places.has(home(row))) places.set(home(row), places.size);
    }
    kept.sort((a, b) => places.get(home(a)) - places.get(home(b)) || (facts.rows[a].kind === "node") - (facts.rows[b].kind === "node") || a - b);
  } else {
    kept.sort((a, b) => failuresOf(b) - failuresOf(a) || a - b);
  }
  timeline.shown = kept;
  const button = byId("fold");
  button.textContent = timeline.folds ? `Show ${quiet} quiet` : `Hide ${quiet} quiet`;
  button.hidden = quiet === 0 || quiet === all.length;
  button.setAttribute("aria-pressed", String(!timeline.folds));
  byId("rows-space").style.height = `${kept.length * rowHeight}px`;
  byId("timeline").setAttribute("aria-label", `${kept.length} rows of the timeline; the list of failures says the same in words`);
  redraw();
}

function setFolds(folds) {
  timeline.folds = folds;
  arrangeRows();
}

function drawTimeline() {
  const holder = byId("rows");
  const canvas = byId("timeline");
  const height = Math.min(timeline.shown.length * rowHeight, Math.max(holder.clientHeight, rowHeight));
  const top = holder.scrollTop;
  const pen = prepared(canvas, height);
  const width = plotWidth(canvas);
  const first = Math.floor(top / rowHeight);
  const last = Math.min(timeline.shown.length, Math.ceil((top + height) / rowHeight));
  drawGrid(pen, width, height);
  for (let place = first; place < last; place++) drawRow(pen, timeline.shown[place], place * rowHeight - top, width);
  drawMarks(pen, first, last, top, width);
  drawOver(pen, width, height);
}

function drawRow(pen, row, y, width) {
  const { name, kind } = facts.rows[row];
  const { states, select, text, muted, sans, accent } = colours();
  const lit = row === highlightedRow();
  if (lit) {
    pen.fillStyle = select;
    pen.fillRect(0, y, labelWidth + width + rightMargin, rowHeight);
  }
  pen.font = `${kind === "container" ? "600 " : ""}11px ${sans}`;
  pen.textAlign = "left";
  pen.textBaseline = "middle";
  pen.fillStyle = lit ? accent : kind === "node" ? text : muted;
  const count = failuresOf(row);
  const room = labelWidth - 14 - (count ? 22 : 0);
  pen.fillText(shortened(pen, name, room), 4, y + rowHeight / 2 + 0.5);
  if (count) {
    pen.fillStyle = states[2];
    pen.textAlign = "right";
    pen.font = `600 11px ${sans}`;
    pen.fillText(String(count), labelWidth - 8, y + rowHeight / 2 + 0.5);
  }
  pen.textBaseline = "alphabetic";
  const lanes = data.lanesOfRow[row];
  let from = 0;
  for (let high = lanes.length; from < high; ) {
    const middle = (from + high) >> 1;
    if (lanes[middle].end < axis.begin) from = middle + 1;
    else high = middle;
  }
  for (let i = from; i < lanes.length && lanes[i].begin <= axis.end; i++) {
    const left = Math.max(labelWidth, xOf(lanes[i].begin, width));
    const right = Math.min(labelWidth + width, xOf(lanes[i].end, width));
    pen.fillStyle = states[lanes[i].state];
    pen.fillRect(left, y + 3, Math.max(lanes[i].state === 1 ? 0.5 : 1, right - left), rowHeight - 6);
  }
}

function shortened(pen, name, room) {
  // No letter is so narrow that more would fit, and names can be thousands long.
  const most = Math.ceil(room / 2);
  if (name.length <= most && pen.measureText(name).width <= room) return name;
  let cut = Math.min(name.length - 1, most);
  while (cut > 4 && pen.measureText(`…${name.slice(-cut)}`).width > room) cut--;
  return `…${name.slice(-cut)}`;
}

function drawMarks(pen, first, last, top, width) {
  const { states, card, accent } = colours();
  for (let place = first; place < last; place++) {
    const y = place * rowHeight - top + rowHeight / 2;
    for (const number of data.marksOfRow[timeline.shown[place]]) {
      const { at } = facts.marks[number];
      if (at < axis.begin || at > axis.end) continue;
      const x = xOf(at, width);
      const size = number === timeline.mark ? 7 : 5;
      pen.beginPath();
      pen.moveTo(x, y - size);
      pen.lineTo(x + size, y);
      pen.lineTo(x, y + size);
      pen.lineTo(x - size, y);
      pen.closePath();
      pen.fillStyle = states[2];
      pen.strokeStyle = number === timeline.mark ? accent : card;
      pen.lineWidth = number === timeline.mark ? 2.5 : 1;
      pen.fill();
      pen.stroke();
    }
  }
}

function rowAt(event) {
  const y = event.clientY - byId("timeline").getBoundingClientRect().top + byId("rows").scrollTop;
  return timeline.shown[Math.floor(y / rowHeight)] ?? -1;
}

function markAt(event, row) {
  const canvas = byId("timeline");
  const x = event.clientX - canvas.getBoundingClientRect().left;
  let best = -1;
  let distance = 8;
  for (const number of data.marksOfRow[row] ?? []) {
    const away = Math.abs(xOf(facts.marks[number].at, plotWidth(canvas)) - x);
    if (away < distance) [best, distance] = [number, away];
  }
  return best;
}

function describeRow(row, at) {
  const { name, container, kind } = facts.rows[row];
  const lane = data.lanesOfRow[row].find((each) => each.begin <= at && at <= each.end);
  const state = lane ? `${["constructing", "loaded", "failed", "away"][lane.state]} for ${span(lane.end - lane.begin)}` : "";
  return [`${name}${container ? ` in ${container}` : kind === "node" ? "" : ` (${kind})`}`, `${clock(at)}  ${state}`].join("\n");
}

function selectRow(row) {
  timeline.selected = row;
  byId("log-row-name").textContent = row >= 0 ? rowName(row) : "the selected node";
  redraw();
  filterLog();
}

// Scrolls to a row, and shows the quiet ones if it is one.
function revealRow(row) {
  if (row < 0 || row >= facts.rows.length) return;
  if (!timeline.shown.includes(row)) setFolds(false);
  const holder = byId("rows");
  const y = timeline.shown.indexOf(row) * rowHeight;
  if (y < holder.scrollTop || y + rowHeight > holder.scrollTop + holder.clientHeight) holder.scrollTop = y - holder.clientHeight / 2;
}

function startTimeline() {
  const canvas = byId("timeline");
  followMouse(canvas, (event) => {
    const row = rowAt(event);
    const mark = markAt(event, row);
    if (mark >= 0) showFailure(mark);
    else selectRow(row === timeline.selected ? -1 : row);
  });
  canvas.addEventListener("pointermove", (event) => {
    const row = rowAt(event);
    timeline.hovered = row;
    if (row < 0 || axis.drag) return hideTip();
    const mark = markAt(event, row);
    canvas.style.cursor = mark >= 0 || !isOverPlot(canvas, event) ? "pointer" : "";
    if (mark >= 0) showTip(event, `${rowName(row)} ${facts.marks[mark].what} at ${clock(facts.marks[mark].at)}\n${facts.marks[mark].reason}`);
    else showTip(event, isOverPlot(canvas, event) ? describeRow(row, axis.cursor) : `${rowName(row)}${facts.rows[row].container ? ` in ${facts.rows[row].container}` : ""}`);
  });
  canvas.addEventListener("pointerleave", () => { timeline.hovered = -1; });
  byId("rows").addEventListener("scroll", redraw, { passive: true });
  byId("order").addEventListener("change", arrangeRows);
  byId("fold").addEventListener("click", () => setFolds(!timeline.folds));
  byId("zoom-in").addEventListener("click", () => zoom(0.5));
  byId("zoom-out").addEventListener("click", () => zoom(2));
  byId("zoom-all").addEventListener("click", () => setRange(0, axis.whole));
  axis.listeners.push(drawTimeline);
  arrangeRows();
}
