// What is no plot: the story, figures, bring-up, topics, configuration, session.

function startTables() {
  byId("title").textContent = facts.title;
  byId("subtitle").textContent = `${wallClock(0)}, ${span(facts.end)}, ${facts.file} (${bytes(facts.bytes)})`;
  if (facts.notices.length) {
    byId("notices").append(make("div", { className: "notice", role: "alert" }, ...facts.notices.map((text) => make("p", { text }))));
  }
  showFigures();
  showStory();
  showBringUp();
  showTopics();
  showParameters();
  showConfiguration();
  fillTable(byId("session"), [], Object.entries(facts.session).map(([name, value]) => [make("td", { text: name }), make("td", { text: value, dir: "auto" })]));
}

function fillTable(table, heads, rows) {
  if (heads.length) table.append(make("thead", {}, make("tr", {}, ...heads.map(([text, className]) => make("th", { text, className, scope: "col" })))));
  table.append(make("tbody", {}, ...rows.map((cells) => make("tr", {}, ...cells))));
}

function showFigures() {
  const kind = (name) => facts.rows.filter((row) => row.kind === name).length;
  const of = (...names) => facts.marks.filter((mark) => names.includes(mark.what)).length;
  const figures = [
    [span(facts.end), "duration", false],
    [kind("node"), "composable nodes", false],
    [kind("container"), "containers", false],
    [kind("process"), "processes", false],
    [of("crashed"), "crashes of nodes", of("crashed") > 0],
    [of("died"), "deaths of processes", of("died") > 0],
    [of("failed to load"), "failed loads", of("failed to load") > 0],
    [new Set(facts.marks.filter((mark) => mark.what === "gave up").map((mark) => mark.row)).size, "gave up", of("gave up") > 0],
    [facts.came_up === null ? "not complete" : span(facts.came_up), "bring-up", facts.came_up === null],
  ];
  for (const [value, name, isBad] of figures) {
    byId("figures").append(make("li", { className: isBad ? "bad" : "" }, make("b", { text: value }), make("span", { text: name })));
  }
}

const pointsShown = 4;
const linesShown = 2;

function showStory() {
  if (!facts.story.length) {
    byId("story").replaceWith(make("p", { text: "Nothing went wrong in this session." }));
    return;
  }
  const items = facts.story.map(pointItem);
  byId("story").append(...items.slice(0, pointsShown));
  const others = items.slice(pointsShown);
  if (!others.length) return;
  const rest = make("ol", { start: pointsShown + 1 }, ...others);
  byId("story").after(make("details", {}, make("summary", { text: `${others.length} more` }), rest));
}

function pointItem(point) {
  const item = make("li", { className: point.is_failure ? "" : "note" });
  const title = make(point.at === null ? "b" : "button", { text: point.title, dir: "auto" });
  if (point.at !== null) {
    title.type = "button";
    title.addEventListener("click", () => goTo(point));
  }
  item.append(title);
  const lines = (from, to) => make("div", { className: "lines", text: point.lines.slice(from, to).join("\n"), dir: "auto" });
  if (point.lines.length) item.append(lines(0, linesShown));
  if (point.lines.length > linesShown) item.append(make("details", {}, make("summary", { text: "more" }), lines(linesShown)));
  return item;
}

function goTo(point) {
  const isAbout = (mark) => !point.name || rowName(mark.row) === point.name;
  const mark = facts.marks.findIndex((each) => Math.abs(each.at - point.at) < 1000 && isAbout(each));
  if (mark >= 0) {
    showFailure(mark);
    return;
  }
  const row = facts.rows.findIndex((each) => each.name === point.name);
  bringIntoView(byId("timeline-card"));
  if (row >= 0) {
    revealRow(row);
    selectRow(row);
  }
  showMoment(point.at);
  showInLog(point.at);
}

function showBringUp() {
  const last = facts.arrivals[0];
  if (!last) {
    byId("bring-up-card").hidden = true;
    return;
  }
  const missing = facts.arrivals.filter((each) => each.end === null);
  byId("bring-up-text").textContent = facts.came_up === null
    ? `Never came up: ${missing.map((each) => rowName(each.row)).join(", ")}.`
    : `All nodes were there, or had failed, after ${span(facts.came_up)}. The last was ${rowName(last.row)} (${last.result}).`;
  byId("chain").replaceChildren(...facts.chain.map((each) => make("li", { text: each, dir: "auto" })));
  const whole = Math.max(...facts.arrivals.map((each) => each.end ?? 0), 1);
  fillTable(byId("arrivals"), [["Node"], ["Container"], ["Result"], ["Constructor", "number"], ["There after", "number"], [""]],
    facts.arrivals.map((each) => [
      named(rowName(each.row)),
      named(facts.rows[each.row]?.container ?? ""),
      make("td", { text: each.result || "never came" }),
      make("td", { className: "number", text: each.end !== null && each.constructing !== null ? span(each.end - each.constructing) : "" }),
      make("td", { className: "number", text: each.end === null ? "" : span(each.end) }),
      make("td", { className: "bar-cell" }, stretch(each, whole)),
    ]));
}

// A cell that may be cut; pointing at it shows all of it.
function named(text) {
  return make("td", { text, title: text, dir: "auto" });
}

function waitedFor(arrival) {
  const { starting, running, requested, constructing, end } = arrival;
  const parts = [];
  if (starting !== null && running !== null) parts.push(`${span(starting)} until its container was started, ${span(running - starting)} until that was ready`);
  if (requested !== null && running !== null && requested - running > 50) parts.push(`${span(requested - running)} until it was its turn`);
  if (constructing !== null && end !== null) parts.push(`${span(end - constructing)} in its constructor`);
  return `${rowName(arrival.row)} (${arrival.result}): ${parts.join(", ")}.`;
}

function stretch(arrival, whole) {
  const bar = make("div", { className: "stretch", title: waitedFor(arrival) });
  const end = arrival.end ?? whole;
  const add = (className, from, to) => {
    if (from === null || to === null || to <= from) return;
    const part = make("i", { className });
    part.style.left = `${(100 * from) / whole}%`;
    part.style.width = `${(100 * (to - from)) / whole}%`;
    bar.append(part);
  };
  add("start", arrival.starting, arrival.running);
  add("wait", arrival.running, arrival.constructing ?? arrival.requested);
  add("build", arrival.constructing, end);
  return bar;
}

function showTopics() {
  const isOurs = (topic) => topic.name.startsWith("/play_launch");
  const topics = [...facts.topics].sort((a, b) => isOurs(a) - isOurs(b) || b.messages - a.messages);
  const seconds = Math.max(facts.end / 1000, 0.001);
  fillTable(byId("topics"), [["Topic"], ["Type"], ["Messages", "number"], ["Mean rate", "number"], ["Highest rate", "number"], ["Over the session"]],
    topics.map((topic) => [
      named(topic.name),
      make("td", { text: topic.type_name, className: "muted" }),
      make("td", { className: "number", text: topic.messages.toLocaleString("en") }),
      make("td", { className: "number", text: rate(topic.messages / seconds) }),
      make("td", { className: "number", text: rate(Math.max(...topic.counts, 0) / (facts.part / 1000)) }),
      make("td", {}, make("canvas", { "aria-hidden": "true", className: "spark" })),
    ]));
  const canvases = byId("topics").querySelectorAll("canvas");
  const draw = () => topics.forEach((topic, i) => drawRate(canvases[i], topic.counts));
  theme.listeners.push(draw);
  draw();
}

function rate(hertz) {
  return `${hertz >= 100 ? Math.round(hertz).toLocaleString("en") : +hertz.toPrecision(2)} Hz`;
}

function drawRate(canvas, counts) {
  const ratio = devicePixelRatio || 1;
  canvas.width = 260 * ratio;
  canvas.height = 20 * ratio;
  const pen = canvas.getContext("2d");
  const most = Math.max(...counts, 1);
  const edge = (part) => Math.round((part * canvas.width) / counts.length);
  pen.fillStyle = colours().accent;
  counts.forEach((count, part) => {
    const height = Math.round((count / most) * canvas.height);
    pen.fillRect(edge(part), canvas.height - height, Math.max(edge(part + 1) - edge(part), 1), height);
  });
}

function showParameters() {
  const place = byId("parameters");
  if (!facts.parameters.length) {
    byId("parameters-card").hidden = true;
    document.querySelector("a[href='#parameters-card']").hidden = true;
    return;
  }
  for (const each of facts.parameters) {
    const counts = [counted(each.values.length, "parameter")];
    if (each.changes.length) counts.push(counted(each.changes.length, "change"));
    const item = make("details", {}, make("summary", { text: `${each.node} (${counts.join(", ")})`, dir: "auto" }));
    // Rows of all nodes would be thousands of elements that are hardly ever read.
    const fill = () => fillParameters(item, each);
    item.addEventListener("toggle", fill, { once: true });
    place.append(item);
  }
}

function fillParameters(item, { note, values, changes }) {
  if (note) item.append(make("p", { className: "muted", text: note }));
  if (values.length) {
    const table = make("table", { className: "wide" });
    fillTable(table, [["Name"], ["Value at the end"]], values.map(([name, value]) => [named(name), make("td", { text: value, dir: "auto" })]));
    item.append(table);
  }
  if (changes.length) {
    const table = make("table", { className: "wide" });
    fillTable(table, [["Changed after", "number"], ["Name"], ["From"], ["To"]], changes.map((change) => [
      make("td", { className: "number", text: span(change.at) }),
      named(change.name),
      make("td", { text: change.before, dir: "auto" }),
      make("td", { text: change.after, dir: "auto" }),
    ]));
    item.append(table);
  }
}

function showConfiguration() {
  const place = byId("configuration");
  const { files, before, difference } = facts.configuration;
  if (!before) place.append(make("p", { className: "muted", text: "There is no session before this one in its folder to compare with." }));
  else if (!difference.length) place.append(make("p", { text: `The same as in the session before, ${before}.` }));
  else {
    place.append(make("p", { text: `What differs from the session before, ${before}:` }));
    place.append(make("pre", { className: "difference" }, ...difference.map((line) => make("span", {
      text: line,
      className: /^(---|\+\+\+|@@)/.test(line) ? "place" : line.startsWith("+") ? "plus" : line.startsWith("-") ? "minus" : "",
    }))));
  }
  for (const file of files) {
    place.append(make("details", {}, make("summary", { text: `${file.name} (${counted(file.text.split("\n").length, "line")})` }), make("pre", { text: file.text })));
  }
}
