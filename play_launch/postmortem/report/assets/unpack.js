// Columns of numbers and texts, as `series.py` packs them.

const missing = 0xffff;
const facts = JSON.parse(document.getElementById("facts").textContent);

async function unpack(name) {
  const holder = document.getElementById(name);
  const text = atob(holder.textContent);
  holder.remove();
  const bytes = new Uint8Array(text.length);
  for (let i = 0; i < text.length; i++) bytes[i] = text.charCodeAt(i);
  const stream = new Blob([bytes]).stream().pipeThrough(new DecompressionStream("deflate"));
  return new Uint8Array(await new Response(stream).arrayBuffer());
}

// 16-bit columns, one behind the other: low bytes, then high bytes, of differences.
function valuesOf(bytes) {
  const count = bytes.length / 2;
  const values = new Uint16Array(count);
  let value = 0;
  for (let i = 0; i < count; i++) {
    value = (value + bytes[i] + (bytes[count + i] << 8)) & 0xffff;
    values[i] = value;
  }
  return values;
}

// Times in milliseconds, a column for each count: changes of the distance, zigzag, in four planes.
function timesOf(bytes, counts) {
  const total = bytes.length / 4;
  const columns = [];
  let at = 0;
  for (const count of counts) {
    const column = new Float64Array(count);
    let before = 0;
    let distance = 0;
    for (let i = 0; i < count; i++, at++) {
      const zigzag =
        (bytes[at] | (bytes[total + at] << 8) | (bytes[2 * total + at] << 16) | (bytes[3 * total + at] << 24)) >>> 0;
      distance = (distance + ((zigzag >>> 1) ^ -(zigzag & 1))) | 0;
      before = (before + distance) | 0;
      column[i] = before;
    }
    columns.push(column);
  }
  return columns;
}

// Series with their columns as numbers; NaN where nothing is known.
async function unpackSeries(name, packed, columnCount) {
  const times = timesOf(await unpack(`${name}_times`), packed.map((each) => each.count));
  const series = packed.map((each, i) => ({ row: each.row, isShared: each.is_shared, times: times[i], columns: [] }));
  for (let column = 0; column < columnCount; column++) {
    const steps = valuesOf(await unpack(`${name}_${column}`));
    let at = 0;
    packed.forEach((each, i) => {
      const { low, high } = each.scales[column];
      const scale = (high - low) / 0xfffe;
      const values = new Float32Array(each.count);
      for (let k = 0; k < each.count; k++, at++) values[k] = steps[at] === missing ? NaN : low + steps[at] * scale;
      series[i].columns.push(values);
    });
  }
  return series;
}

// The first index of a rising column whose value is not below `value`.
function lowerBound(column, value) {
  let low = 0;
  let high = column.length;
  while (low < high) {
    const middle = (low + high) >> 1;
    if (column[middle] < value) low = middle + 1;
    else high = middle;
  }
  return low;
}
