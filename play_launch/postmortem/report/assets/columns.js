// What was unpacked: stays in states, series of numbers, lines of the log.

const data = { lanesOfRow: [], marksOfRow: [], series: [], seriesOfRow: new Map(), system: null, lines: null };

async function loadColumns() {
  const [rows, states, times, series, system] = await Promise.all([
    unpack("lane_rows"), unpack("lane_states"), unpack("lane_times"),
    unpackSeries("series", facts.series, facts.columns.length),
    unpackSeries("system", [facts.system], facts.system_columns.length),
  ]);
  const [begins, ends] = timesOf(times, [facts.lanes, facts.lanes]);
  data.lanesOfRow = facts.rows.map(() => []);
  data.marksOfRow = facts.rows.map(() => []);
  valuesOf(rows).forEach((row, i) => data.lanesOfRow[row]?.push({ state: states[i], begin: begins[i], end: ends[i] }));
  facts.marks.forEach((mark, i) => data.marksOfRow[mark.row]?.push(i));
  data.series = series;
  for (const each of series) data.seriesOfRow.set(each.row, each);
  data.system = system[0];
}

async function loadLines() {
  const [rows, levels, times, texts] = await Promise.all(["line_rows", "line_levels", "line_times", "line_texts"].map(unpack));
  data.lines = {
    rows: valuesOf(rows),
    levels,
    times: timesOf(times, [facts.lines])[0],
    texts: facts.lines ? new TextDecoder().decode(texts).split("\n") : [],
    lower: null,
  };
}

// Text for a search that takes no notice of capitals; made when it is first needed.
function lowerTexts() {
  const lines = data.lines;
  lines.lower ??= lines.texts.map((text) => text.toLowerCase());
  return lines.lower;
}

// Numbers of the last lines of a row up to a moment, the earliest first. What no node of a container
// has put a name to may be any of its nodes'.
function lastLines(row, at, most) {
  const { rows, times, texts } = data.lines;
  const { kind, container } = facts.rows[row] ?? {};
  const home = kind === "node" ? facts.rows.findIndex((each) => each.kind === "container" && each.name === container) : -1;
  const isNameless = (text) => !/^\[[^\]]*\]: /.test(text);
  const found = [];
  for (let i = lowerBound(times, at + 1) - 1; i >= 0 && found.length < most && times[i] > at - 60000; i--) {
    if (rows[i] === row || (rows[i] === home && isNameless(texts[i]))) found.push(i);
  }
  return found.reverse();
}
