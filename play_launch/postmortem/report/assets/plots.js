// What processes and the machine used. All processes are drawn as a density: each pixel is the darker
// the more of them pass through it; so a spike of one second stays visible among a hundred others.

const plots = [];

function makePlot(title, unit, height, series, names, columns) {
  const canvas = make("canvas", { role: "img", "aria-label": `${title} over time` });
  byId("plots").append(canvas);
  const plot = { title, unit, height, series, names, columns, canvas, image: null, key: "", top: 1, gap: gapOf(series) };
  plots.push(plot);
  followMouse(canvas, () => selectRow(timeline.hovered));
  canvas.addEventListener("pointermove", (event) => pointAt(plot, event));
  canvas.addEventListener("pointerleave", () => { timeline.hovered = -1; });
}

// Two samples that are further apart than this are not joined: nothing is known in between.
function gapOf(series) {
  const distances = [];
  for (const { times } of series) {
    for (let i = 1; i < Math.min(times.length, 40); i++) distances.push(times[i] - times[i - 1]);
  }
  distances.sort((a, b) => a - b);
  return 3.5 * Math.max(distances[distances.length >> 1] ?? 1000, 1);
}

function startPlots() {
  const own = data.series.filter((each) => !each.isShared);
  if (data.series.length) makePlot("CPU of a core", percent, 120, data.series, null, [0]);
  if (own.length) makePlot("Memory", bytes, 120, own, null, [1]);
  if (data.system.times.length) makePlot("Machine", percent, 110, [data.system], ["CPU", "memory", "CPU pressure", "memory pressure", "I/O pressure", "steal"], [0, 1, 2, 3, 4, 5]);
  if (!plots.length) byId("plots").append(make("p", { className: "muted", text: "The recording holds no samples of CPU and memory." }));
  axis.listeners.push(() => plots.forEach(drawPlot));
}

// Indices of the samples that are needed to draw the range: one beyond it on either side.
function visible(times) {
  return [Math.max(0, lowerBound(times, axis.begin) - 1), Math.min(times.length, lowerBound(times, axis.end) + 1)];
}

function highestOf(plot) {
  let highest = 0;
  for (const { times, columns } of plot.series) {
    const [from, to] = visible(times);
    for (const column of plot.columns) {
      const values = columns[column];
      for (let i = from; i < to; i++) if (values[i] > highest) highest = values[i];
    }
  }
  return plot.names ? Math.max(100, highest) : highest || 1;
}

function yOf(plot, value) {
  return plot.height - 5 - (value / plot.top) * (plot.height - 14);
}

function trace(pen, plot, times, values, width) {
  const [from, to] = visible(times);
  pen.beginPath();
  let before = -Infinity;
  for (let i = from; i < to; i++) {
    if (Number.isNaN(values[i])) continue;
    const x = xOf(times[i], width);
    const y = yOf(plot, values[i]);
    if (times[i] - before > plot.gap) {
      pen.moveTo(x - 0.5, y);
    }
    pen.lineTo(x, y);
    before = times[i];
  }
  pen.stroke();
}

// Counts in `hits` through which pixels a series passes: a line from sample to sample, in each column
// of pixels from its lowest to its highest point.
function countPixels(hits, plot, times, values, wide, high, ratio) {
  const [from, to] = visible(times);
  const scale = wide / (axis.end - axis.begin);
  let column = -1;
  let low = 0;
  let top = 0;
  let level = 0;
  let before = -Infinity;
  const put = (x) => {
    if (x < 0 || x >= wide) return;
    for (let y = Math.max(0, top); y <= low && y < high; y++) hits[y * wide + x]++;
  };
  for (let i = from; i < to; i++) {
    if (Number.isNaN(values[i])) continue;
    const x = Math.floor((times[i] - axis.begin) * scale);
    const y = Math.round(yOf(plot, values[i]) * ratio);
    if (times[i] - before > plot.gap) {
      if (column >= 0) put(column);
      [column, low, top] = [x, y, y];
    } else if (x === column) {
      low = Math.max(low, y);
      top = Math.min(top, y);
    } else {
      const step = (y - level) / (x - column);
      const edge = (at) => Math.round(level + step * (at - column - 0.5)); // on the left of a column
      [low, top] = [Math.max(low, edge(column + 1)), Math.min(top, edge(column + 1))];
      put(column);
      for (let between = Math.max(column + 1, 0); between < Math.min(x, wide); between++) {
        const [one, two] = [edge(between), edge(between + 1)];
        [low, top] = [Math.max(one, two), Math.min(one, two)];
        put(between);
      }
      const left = edge(x);
      [column, low, top] = [x, Math.max(y, left), Math.min(y, left)];
    }
    level = y;
    before = times[i];
  }
  if (column >= 0) put(column);
}

function density(plot, width) {
  const ratio = devicePixelRatio || 1;
  const key = [axis.begin, axis.end, width, ratio, document.documentElement.dataset.theme].join(" ");
  if (key === plot.key) return plot.image;
  plot.key = key;
  plot.top = highestOf(plot);
  const wide = Math.round(width * ratio);
  const high = Math.round(plot.height * ratio);
  const image = new OffscreenCanvas(wide, high);
  const pen = image.getContext("2d");
  let samples = 0;
  for (const { times } of plot.series) {
    const [from, to] = visible(times);
    samples = Math.max(samples, to - from);
  }
  const [red, green, blue] = colours().density;
  if (samples * 2 < wide) {
    pen.setTransform(ratio, 0, 0, ratio, -labelWidth * ratio, 0);
    pen.strokeStyle = `rgb(${red} ${green} ${blue} / 45%)`;
    for (const { times, columns } of plot.series) trace(pen, plot, times, columns[plot.columns[0]], width);
  } else {
    const hits = new Uint16Array(wide * high);
    for (const { times, columns } of plot.series) countPixels(hits, plot, times, columns[plot.columns[0]], wide, high, ratio);
    const pixels = pen.createImageData(wide, high);
    const packed = new Uint32Array(pixels.data.buffer);
    const most = Math.max(4, plot.series.length * 0.6);
    const shades = new Uint32Array(most + 2).map((_, count) => ((Math.round(255 * Math.min(1, 0.3 + 0.7 * Math.sqrt((count - 1) / most))) << 24) | (blue << 16) | (green << 8) | red) >>> 0);
    for (let i = 0; i < hits.length; i++) if (hits[i]) packed[i] = shades[Math.min(hits[i], shades.length - 1)];
    pen.putImageData(pixels, 0, 0);
  }
  plot.image = image;
  return image;
}

function drawPlot(plot) {
  const pen = prepared(plot.canvas, plot.height);
  const width = plotWidth(plot.canvas);
  const { muted, grid, text, accent, series, sans } = colours();
  drawGrid(pen, width, plot.height);
  const image = plot.names ? null : density(plot, width);
  if (plot.names) plot.top = highestOf(plot);
  const step = niceStep(plot.top, 3);
  pen.font = `10px ${sans}`;
  pen.textAlign = "right";
  for (let value = 0; value <= plot.top; value += step) {
    pen.fillStyle = grid;
    pen.fillRect(labelWidth, Math.round(yOf(plot, value)), width, 1);
    pen.fillStyle = muted;
    pen.fillText(plot.unit(value), labelWidth - 8, yOf(plot, value) + 3);
  }
  pen.textAlign = "left";
  pen.font = `600 11px ${sans}`;
  pen.fillStyle = text;
  pen.fillText(plot.title, 4, 14);
  pen.save();
  pen.beginPath();
  pen.rect(labelWidth, 0, width, plot.height);
  pen.clip();
  pen.lineJoin = "round";
  if (plot.names) {
    pen.lineWidth = 1.3;
    [...plot.names.keys()].reverse().forEach((number) => {
      pen.strokeStyle = series[number];
      trace(pen, plot, plot.series[0].times, plot.series[0].columns[number], width);
    });
  } else {
    pen.drawImage(image, labelWidth, 0, width, plot.height);
    const lit = seriesOf(plot, highlightedRow());
    if (lit) {
      pen.strokeStyle = accent;
      pen.lineWidth = 1.6;
      trace(pen, plot, lit.times, lit.columns[plot.columns[0]], width);
    }
  }
  pen.restore();
  pen.font = `10px ${sans}`;
  if (plot.names) drawNames(pen, plot);
  else drawLit(pen, plot);
  drawOver(pen, width, plot.height);
}

// The series of a row; that of its container where the node has none of its own.
function seriesOf(plot, row) {
  if (row < 0) return undefined;
  const own = plot.series.find((each) => each.row === row);
  if (own) return own;
  const container = facts.rows.findIndex((each) => each.kind === "container" && each.name === facts.rows[row]?.container);
  return container >= 0 ? plot.series.find((each) => each.row === container) : undefined;
}

function valueAt(plot, series, column, at) {
  if (at === null) return NaN;
  const i = lowerBound(series.times, at);
  const near = i > 0 && (i === series.times.length || at - series.times[i - 1] < series.times[i] - at) ? i - 1 : i;
  return Math.abs((series.times[near] ?? Infinity) - at) <= plot.gap ? series.columns[column][near] : NaN;
}

function drawNames(pen, plot) {
  const { series } = colours();
  plot.names.forEach((name, number) => {
    const value = valueAt(plot, plot.series[0], number, axis.cursor);
    pen.fillStyle = series[number];
    pen.fillText(`${name}${Number.isNaN(value) ? "" : ` ${plot.unit(value)}`}`, 4, 29 + number * 13);
  });
}

function drawLit(pen, plot) {
  const lit = seriesOf(plot, highlightedRow());
  if (!lit) {
    pen.fillStyle = colours().muted;
    pen.fillText(counted(plot.series.length, "process", "processes"), 4, 29);
    return;
  }
  pen.fillStyle = colours().accent;
  pen.fillText(shortened(pen, rowName(lit.row), labelWidth - 60), 4, 29);
  const value = valueAt(plot, lit, plot.columns[0], axis.cursor);
  if (!Number.isNaN(value)) pen.fillText(plot.unit(value), 4, 43);
}

// Singles out the series that passes closest to the mouse.
function pointAt(plot, event) {
  if (plot.names || axis.drag || axis.cursor === null) return hideTip();
  const y = event.clientY - plot.canvas.getBoundingClientRect().top;
  let best = null;
  let distance = 30;
  for (const each of plot.series) {
    const value = valueAt(plot, each, plot.columns[0], axis.cursor);
    const away = Math.abs(yOf(plot, value) - y);
    if (away < distance) [best, distance] = [{ row: each.row, value }, away];
  }
  timeline.hovered = best?.row ?? -1;
  if (best) showTip(event, `${rowName(best.row)}\n${clock(axis.cursor)}  ${plot.unit(best.value)}`);
  else hideTip();
}
