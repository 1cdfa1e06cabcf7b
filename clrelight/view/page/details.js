// HL, LH and HH of a unit of klt 4: hints, flags, batches and contexts of docs/bitstream.md.
"use strict";
(() => {
  const clrelight = (globalThis.clrelight ??= {});
  const { PITCH, bitsOf, classOf } = clrelight;

  const SIDE = 64;
  // All samples of a unit, and what belongs to them: made once, since a unit is decoded at a time.
  const hint = new Int32Array(SIDE * SIDE);
  const places = new Int32Array(SIDE * SIDE);
  const heres = new Int32Array(SIDE * SIDE); // the same in sizes
  const contexts = new Int32Array(SIDE * SIDE);
  const shifts = new Int32Array(SIDE * SIDE);
  const symbols = new Uint8Array(SIDE * SIDE);
  const cells = new Int32Array(SIDE);
  const flags = new Uint8Array(10 * 10);
  const size = [0, 1, 2].map(() => new Uint8Array(PITCH * PITCH));
  const before = [0, 1, 2].map(() => new Int32Array(SIDE * SIDE));
  const NEIGHBOURS = [[], [-PITCH - 1, -PITCH + 1, PITCH - 1, PITCH + 1], [-PITCH, PITCH, -1, 1]];

  // Of each band whether anything is there: of this plane, and of those before. Most of fine planes are empty.
  const live = [false, false, false];
  const lived = [false, false, false];

  /**
   * Decode the subbands of a unit.
   *
   * bands: of HL, LH and HH {rows, columns} in the unit, null where it has no samples; parents: of each {values, live,
   * rows, columns, top, left} of the unit above, null where it has none at the first place. Returns of each band
   * {values: integers [plane, row, column], live: whether a plane has any}.
   */
  function decodeDetails(stream, tables, planes, bands, parents) {
    const found = bands.map(
      (band) => band && { values: new Int32Array(planes * band.rows * band.columns), live: new Uint8Array(planes) },
    );
    for (const each of before) each.fill(0);
    lived.fill(false);
    for (let plane = 0; plane < planes; plane++) {
      for (let b = 0; b < 3; b++) if (live[b] || !plane) size[b].fill(0);
      live.fill(false);
      for (let b = 0; b < 3; b++) {
        const band = bands[b];
        if (!band) continue;
        const count = band.rows * band.columns;
        const sum = makeHints(plane, b, band, parents[b]);
        const out = found[b].values.subarray(plane * count, (plane + 1) * count);
        live[b] = decodeBand(stream, tables, plane, band, sum, size[b], out);
        found[b].live[plane] = live[b] ? 1 : 0;
        if (live[b] || lived[b]) remember(plane, band, size[b], before[b]);
        lived[b] ||= live[b];
      }
    }
    return found;
  }

  /** Fill in the hints of a band; return their sum. */
  function makeHints(plane, b, { rows, columns }, parent) {
    const weight = b + (parent ? 1 : 0) + (plane ? 6 : 0);
    const count = rows * columns;
    if (!weight) {
      hint.fill(16, 0, count);
      return 16 * count;
    }
    const fromParent = parent && parent.live[plane];
    const fromFirst = b > 0 && live[0];
    const fromSecond = b > 1 && live[1];
    const fromBefore = plane > 0 && lived[b];
    if (!fromParent && !fromFirst && !fromSecond && !fromBefore) {
      hint.fill(0, 0, count);
      return 0;
    }
    hint.fill(0, 0, count);
    if (fromFirst) addSizes(size[0], rows, columns);
    if (fromSecond) addSizes(size[1], rows, columns);
    if (fromParent) addParent(parent, plane, rows, columns);
    const factor = weight === 1 ? 65536 : Math.floor(65536 / weight) + 1;
    const known = before[b];
    let sum = 0;
    for (let at = 0; at < count; at++) {
      const value = 16 * hint[at] + (fromBefore ? 6 * known[at] : 0);
      sum += hint[at] = weight === 1 ? value : (value * factor) >> 16;
    }
    return sum;
  }

  function addSizes(sizes, rows, columns) {
    for (let y = 0, at = 0; y < rows; y++)
      for (let x = 0, here = (y + 1) * PITCH + 1; x < columns; x++, at++, here++) hint[at] += sizes[here];
  }

  function addParent(parent, plane, rows, columns) {
    const high = Math.min(rows, 2 * (parent.rows - parent.top));
    const wide = Math.min(columns, 2 * (parent.columns - parent.left));
    for (let y = 0; y < high; y++) {
      const from = (plane * parent.rows + parent.top + (y >> 1)) * parent.columns + parent.left;
      for (let x = 0, at = y * columns; x < wide; x++, at++) {
        const value = parent.values[from + (x >> 1)];
        hint[at] += Math.min(value < 0 ? -value : value, 255);
      }
    }
  }

  function remember(plane, { rows, columns }, sizes, old) {
    const fade = (plane > 0 ? 1 : 0) + (plane > 2 ? 1 : 0) + (plane > 10 ? 1 : 0);
    for (let y = 0, at = 0; y < rows; y++)
      for (let x = 0, here = (y + 1) * PITCH + 1; x < columns; x++, at++, here++) {
        old[at] += (16 * sizes[here] - old[at]) >> fade;
      }
  }

  /** Decode a band of a plane; return whether anything is there. */
  function decodeBand(stream, tables, plane, { rows, columns }, sum, sizes, out) {
    if (!tables.takeFlag(stream, 112 + (plane ? 16 : 0) + Math.min(classOf(sum >> 4), 15))) return false;
    const count = readCells(stream, tables, rows, columns);
    const group = plane === 0 ? 0 : plane < 8 ? 1 : 2;
    for (let batch = 0; batch < 3; batch++) {
      if (batch) mirror(sizes, rows, columns);
      const found = listPlaces(count, batch, rows, columns);
      addContexts(found, group, batch, sizes);
      const whole = found & ~3;
      for (let i = 0; i < found; i++) symbols[i] = tables.takeSymbol(stream, contexts[i], i < whole ? i & 3 : 0);
      tables.learn(contexts, found);
      for (let i = 0; i < found; i++) {
        if (!symbols[i] && !shifts[i]) continue; // 0, without raw bits
        const magnitude = stream.takeMagnitude(symbols[i], shifts[i], shifts[i] === 4 ? 4 : 0);
        if (!magnitude) continue;
        out[places[i]] = stream.takeBits(1) ? -magnitude : magnitude;
        sizes[heres[i]] = Math.min(magnitude, 255);
      }
    }
    return true;
  }

  /** Read a flag for each cell of 8 x 8 samples; return how many are to be decoded, which `cells` lists. */
  function readCells(stream, tables, rows, columns) {
    let count = 0;
    flags.fill(0);
    for (let top = 0, i = 0; top < rows; top += 8, i++) {
      for (let left = 0, j = 0; left < columns; left += 8, j++) {
        const here = (i + 1) * 10 + j + 1;
        const around = 2 * (flags[here - 1] + flags[here - 10]) + flags[here - 11] + flags[here - 9];
        let hinted = 0;
        for (let y = top; y < Math.min(top + 8, rows); y++)
          for (let x = left; x < Math.min(left + 8, columns); x++) hinted += hint[y * columns + x];
        const flag = 16 * around + Math.min(classOf(Math.min(hinted, 65535) >> 2), 15);
        if ((flags[here] = tables.takeFlag(stream, flag))) cells[count++] = (i << 3) | j;
      }
    }
    return count;
  }

  /** List the places of a batch, cell by cell: even rows and columns; odd ones; all others. */
  function listPlaces(count, batch, rows, columns) {
    let found = 0;
    for (let c = 0; c < count; c++) {
      const top = (cells[c] >> 3) * 8;
      const left = (cells[c] & 7) * 8;
      const bottom = Math.min(top + 8, rows);
      const right = Math.min(left + 8, columns);
      for (let y = top; y < bottom; y++) {
        if (batch < 2 && (y & 1) !== batch) continue;
        const odd = batch === 2 ? (y & 1 ? 0 : 1) : batch;
        for (let x = left + odd; x < right; x += 2) {
          places[found] = y * columns + x;
          heres[found++] = (y + 1) * PITCH + x + 1;
        }
      }
    }
    return found;
  }

  function addContexts(count, group, batch, sizes) {
    const [a, b, c, d] = NEIGHBOURS[batch];
    for (let i = 0; i < count; i++) {
      const known = hint[places[i]];
      const here = heres[i];
      let expected = known >> 4;
      let near = 11;
      if (batch) {
        const around = sizes[here + a] + sizes[here + b] + sizes[here + c] + sizes[here + d];
        near = Math.min(classOf(around), 10);
        expected = Math.max(expected, around >> 2);
      }
      contexts[i] = 192 * group + 16 * near + Math.min(classOf(known), 15);
      shifts[i] = Math.max(bitsOf(expected) - 4, 0);
    }
  }

  /** Continue sizes beyond the edges as their mirror image about the last sample. */
  function mirror(sizes, rows, columns) {
    if (columns > 1)
      for (let y = 0; y < rows + 2; y++) {
        sizes[y * PITCH] = sizes[y * PITCH + 2];
        sizes[y * PITCH + columns + 1] = sizes[y * PITCH + columns - 1];
      }
    if (rows > 1) {
      sizes.copyWithin(0, 2 * PITCH, 3 * PITCH);
      sizes.copyWithin((rows + 1) * PITCH, (rows - 1) * PITCH, rows * PITCH);
    }
  }

  Object.assign(clrelight, { decodeDetails });
})();
