// The log: only the lines that are in sight are elements of the page.

const lineHeight = 18;
const log = { chosen: null, here: -1, pool: [], timer: 0 };

function lineCount() {
  return log.chosen ? log.chosen.length : data.lines.texts.length;
}

function lineNumber(place) {
  return log.chosen ? log.chosen[place] : place;
}

function levelWord(level) {
  return level >= 50 ? "FATAL" : level >= 40 ? "ERROR" : level >= 30 ? "WARN" : level >= 20 ? "INFO" : "DEBUG";
}

function drawLog() {
  if (!data.lines) return;
  const holder = byId("log");
  byId("log-space").style.height = `${lineCount() * lineHeight}px`;
  const first = Math.max(0, Math.floor(holder.scrollTop / lineHeight) - 4);
  const last = Math.min(lineCount(), first + Math.ceil(holder.clientHeight / lineHeight) + 9);
  while (log.pool.length < last - first) {
    const line = make("div", { className: "line" }, ...["time", "level", "unit", "text"].map((className) => make("span", { className })));
    line.lastChild.dir = "auto";
    byId("log-space").append(line);
    log.pool.push(line);
  }
  log.pool.forEach((line, i) => {
    const place = first + i;
    line.hidden = place >= last;
    line.style.display = line.hidden ? "none" : "";
    if (!line.hidden) fillLine(line, place);
  });
}

function fillLine(line, place) {
  const { rows, levels, times, texts } = data.lines;
  const number = lineNumber(place);
  const level = levels[number];
  line.className = `line${level >= 40 ? " error" : level >= 30 ? " warn" : ""}${number === log.here ? " here" : ""}`;
  line.style.top = `${place * lineHeight}px`;
  line.dataset.number = number;
  const [time, word, unit, text] = line.children;
  time.textContent = clock(times[number]);
  word.textContent = levelWord(level).padEnd(5);
  unit.textContent = rowName(rows[number]);
  text.textContent = texts[number];
}

function filterLog() {
  if (!data.lines) return;
  const words = byId("search").value.toLowerCase();
  const least = +byId("level").value;
  const row = byId("log-row").checked ? timeline.selected : -1;
  const inRange = byId("log-range").checked;
  const { rows, levels, times } = data.lines;
  const from = inRange ? lowerBound(times, axis.begin) : 0;
  const to = inRange ? lowerBound(times, axis.end + 1) : times.length;
  if (!words && !least && row < 0 && !inRange) {
    log.chosen = null;
  } else {
    const lower = words ? lowerTexts() : null;
    const chosen = [];
    for (let i = from; i < to; i++) {
      if (levels[i] < least || (row >= 0 && rows[i] !== row)) continue;
      if (words && !lower[i].includes(words) && !rowName(rows[i]).toLowerCase().includes(words)) continue;
      chosen.push(i);
    }
    log.chosen = chosen;
  }
  const all = data.lines.texts.length;
  byId("log-count").textContent = log.chosen ? `${lineCount().toLocaleString("en")} of ${counted(all, "line")}` : counted(all, "line");
  if (log.here >= 0) scrollToLine(log.here);
  else byId("log").scrollTop = 0;
  drawLog();
}

function scrollToLine(number) {
  const place = log.chosen ? lowerBound(log.chosen, number) : number;
  byId("log").scrollTop = Math.max(0, (place + 1) * lineHeight - byId("log").clientHeight / 2);
}

// Shows what was written around a moment.
function showInLog(at) {
  if (!data.lines) return;
  const { times } = data.lines;
  log.here = Math.min(lowerBound(times, at), times.length - 1);
  scrollToLine(log.here);
  drawLog();
}

// The lines that a printed page holds: those in sight, as text.
function printedLog() {
  if (!data.lines) return "";
  const { rows, levels, times, texts } = data.lines;
  const first = Math.max(0, Math.floor(byId("log").scrollTop / lineHeight) - 20);
  const found = [];
  for (let place = first; place < Math.min(lineCount(), first + 80); place++) {
    const i = lineNumber(place);
    found.push(`${clock(times[i])} ${levelWord(levels[i]).padEnd(5)} ${rowName(rows[i])}: ${texts[i]}`);
  }
  return found.join("\n");
}

function soon() {
  clearTimeout(log.timer);
  log.timer = setTimeout(filterLog, 120);
}

function startLog() {
  byId("log").addEventListener("scroll", drawLog, { passive: true });
  for (const id of ["level", "log-row", "log-range"]) byId(id).addEventListener("change", filterLog);
  byId("search").addEventListener("input", () => {
    log.here = -1;
    soon();
  });
  byId("moment").addEventListener("change", (event) => {
    const at = parseClock(event.target.value);
    event.target.setAttribute("aria-invalid", String(at === null));
    if (at === null) return;
    showInLog(at);
    showMoment(at);
  });
  byId("log").addEventListener("click", (event) => {
    const line = event.target.closest(".line");
    if (!line) return;
    log.here = +line.dataset.number;
    showMoment(data.lines.times[log.here]);
    drawLog();
  });
  axis.listeners.push(() => {
    if (byId("log-range").checked && log.range !== `${axis.begin} ${axis.end}`) soon();
    log.range = `${axis.begin} ${axis.end}`;
  });
  filterLog();
}
