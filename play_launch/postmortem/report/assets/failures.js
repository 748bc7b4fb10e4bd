// The list of failures, and the one that is selected: why, where, and what it wrote last.

const lastLinesShown = 20;

function startFailures() {
  const list = byId("failures");
  facts.marks.forEach((mark, number) => {
    const button = make("button", { type: "button", "data-mark": number },
      make("time", { text: clock(mark.at, 1) }),
      make("span", { className: "unit", text: `${rowName(mark.row)} ${mark.what}` }),
      make("span", { className: "why", text: mark.reason }));
    button.addEventListener("click", () => showFailure(number));
    list.append(make("li", {}, button));
  });
  if (!facts.marks.length) list.append(make("li", { className: "muted", text: "Nothing failed." }));
  byId("failures-title").textContent = facts.marks.length ? `Failures (${facts.marks.length})` : "Failures";
  list.addEventListener("keydown", (event) => {
    const step = { ArrowDown: 1, ArrowUp: -1 }[event.key];
    if (!step) return;
    event.preventDefault();
    event.stopPropagation();
    nextFailure(step);
  });
  byId("next").addEventListener("click", () => nextFailure(1));
  byId("previous").addEventListener("click", () => nextFailure(-1));
}

// Scrolls the page unless the beginning of a part is in sight, below the header.
function bringIntoView(part) {
  const { top } = part.getBoundingClientRect();
  if (top < 0 || top > innerHeight * 0.4) part.scrollIntoView({ block: "start" });
}

function nextFailure(step) {
  if (!facts.marks.length) return;
  const from = timeline.mark < 0 ? (step > 0 ? -1 : 0) : timeline.mark;
  showFailure((from + step + facts.marks.length) % facts.marks.length);
}

function showFailure(number) {
  const mark = facts.marks[number];
  timeline.mark = number;
  for (const button of byId("failures").querySelectorAll("[aria-current]")) button.removeAttribute("aria-current");
  const button = byId("failures").querySelector(`[data-mark="${number}"]`);
  button.setAttribute("aria-current", "true");
  const list = byId("failures");
  const top = button.offsetTop - list.offsetTop;
  if (top < list.scrollTop || top + button.offsetHeight > list.scrollTop + list.clientHeight) list.scrollTop = top - list.clientHeight / 3;
  if (document.activeElement?.closest("#failures")) button.focus({ preventScroll: true });
  bringIntoView(byId("timeline-card"));
  revealRow(mark.row);
  if (mark.at < axis.begin || mark.at > axis.end || axis.end - axis.begin === axis.whole) showMoment(mark.at);
  selectRow(mark.row);
  showInLog(mark.at);
  describeFailure(mark);
}

function describeFailure(mark) {
  const place = byId("failure");
  const row = facts.rows[mark.row];
  const lines = data.lines ? lastLines(mark.row, mark.at, lastLinesShown + 1) : [];
  const written = lines.filter((i) => data.lines.texts[i] !== `${mark.what}: ${mark.reason}`).slice(-lastLinesShown);
  place.replaceChildren(
    make("h3", { text: `${rowName(mark.row)} ${mark.what}`, dir: "auto" }),
    make("p", { className: "muted", text: `${clock(mark.at)} after the start, ${wallClock(mark.at)}${row?.container ? `, in ${row.container}` : ""}` }),
    make("h4", { text: "Reason" }),
    make("pre", { text: mark.reason || "none was recorded" }));
  if (mark.backtrace.length) place.append(make("h4", { text: "Backtrace" }), make("pre", { className: "backtrace", text: mark.backtrace.join("\n") }));
  place.append(make("h4", { text: written.length ? `Last output (${counted(written.length, "line")})` : "Last output" }));
  place.append(make("pre", {
    className: "output",
    text: written.map((i) => `${clock(data.lines.times[i])} ${levelWord(data.lines.levels[i]).padEnd(5)} ${data.lines.texts[i]}`).join("\n") || "nothing in the minute before",
  }));
  const same = facts.marks.filter((each) => each.row === mark.row).length;
  place.append(make("h4", { text: "More" }),
    make("p", { text: `${counted(same, "failure")} of ${rowName(mark.row)} in this session.` }),
    make("p", {}, make("code", { text: `play-launch inspect ${facts.file} --around ${(mark.at / 1000).toFixed(3)}s` })));
  place.hidden = false;
  place.scrollTop = 0;
}
