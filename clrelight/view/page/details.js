// HL, LH and HH of a unit of klt 4: hints, flags, batches and contexts of docs/bitstream.md.
"use strict";
(() => {
  const clrelight = (globalThis.clrelight ??= {});
  const { PITCH, bitsOf, classOf } = clrelight;

  const SIDE = 64;
  // All samples of a unit, and what belongs to them: made once, since a unit is decoded at a time.
  const hint = new Int32Array(SIDE * SIDE);
  const places = new Int32Array(SIDE * SIDE);
  const contexts = new Int32Array(SIDE * SIDE);
  const shifts = new Int32Array(SIDE * SIDE);
  const symbols = new Uint8Array(SIDE * SIDE);
  const cells = new Int32Array(SIDE);
  const flags = new Uint8Array(10 * 10);
  const size = [0, 1, 2].map(() => new Uint8Array(PITCH * PITCH));
  const before = [0, 1, 2].map(() => new Int32Array(SIDE * SIDE));
  const NEIGHBOURS = [[], [-PITCH - 1, -PITCH + 1, PITCH - 1, PITCH + 1], [-PITCH, PITCH, -1, 1]];

  /**
   * Decode the subbands of a unit.
   *
   * bands: of HL, LH and HH {rows, columns} in the unit, null where it has no samples; parents: of each {values, rows,
   * columns, top, left, height, width} of the unit above, null where it has none at the first place. Returns of each
   * band integers [plane, row, column].
   */
  function decodeDetails(stream, tables, planes, bands, parents) {
    const found = bands.map((band) => band && new Int32Array(planes * band.rows * band.columns));
    for (const each of before) each.fill(0);
    for (let plane = 0; plane < planes; plane++) {
      for (const each of size) each.fill(0);
      for (let b = 0; b < 3; b++) {
        const band = bands[b];
        if (!band) continue;
        makeHints(plane, b, band, parents[b]);
        const count = band.rows * band.columns;
        decodeBand(stream, tables, plane, band, size[b], found[b].subarray(plane * count, (plane + 1) * count));
        remember(plane, band, size[b], before[b]);
      }
    }
    return found;
  }

  function makeHints(plane, b, { rows, columns }, parent) {
    const weight = b + (parent ? 1 : 0) + (plane ? 6 : 0);
    if (!weight) {
      hint.fill(16, 0, rows * columns);
      return;
    }
    const factor = Math.floor(65536 / weight) + 1;
    const [first, second] = size;
    const known = before[b];
    for (let y = 0, at = 0; y < rows; y++) {
      for (let x = 0; x < columns; x++, at++) {
        const here = (y + 1) * PITCH + x + 1;
        let sizes = (b > 0 ? first[here] : 0) + (b > 1 ? second[here] : 0);
        if (parent) sizes += parentSize(parent, plane, y >> 1, x >> 1);
        const sum = 16 * sizes + (plane ? 6 * known[at] : 0);
        hint[at] = weight === 1 ? sum : (sum * factor) >> 16;
      }
    }
  }

  function parentSize(parent, plane, row, column) {
    const y = parent.top + row;
    const x = parent.left + column;
    if (y >= parent.rows || x >= parent.columns) return 0;
    const value = parent.values[(plane * parent.rows + y) * parent.columns + x];
    return Math.min(value < 0 ? -value : value, 255);
  }

  function remember(plane, { rows, columns }, sizes, old) {
    const fade = (plane > 0 ? 1 : 0) + (plane > 2 ? 1 : 0) + (plane > 10 ? 1 : 0);
    for (let y = 0, at = 0; y < rows; y++)
      for (let x = 0; x < columns; x++, at++) {
        const scaled = 16 * sizes[(y + 1) * PITCH + x + 1];
        old[at] += (scaled - old[at]) >> fade;
      }
  }

  function decodeBand(stream, tables, plane, band, sizes, out) {
    const { rows, columns } = band;
    let sum = 0;
    for (let i = 0; i < rows * columns; i++) sum += hint[i];
    if (!tables.takeFlag(stream, 112 + (plane ? 16 : 0) + Math.min(classOf(sum >> 4), 15))) return;
    const count = readCells(stream, tables, rows, columns);
    const group = plane === 0 ? 0 : plane < 8 ? 1 : 2;
    for (let batch = 0; batch < 3; batch++) {
      if (batch) mirror(sizes, rows, columns);
      const found = listPlaces(count, batch, rows, columns);
      for (let i = 0; i < found; i++) addContext(i, columns, group, batch, sizes);
      const whole = found & ~3;
      for (let i = 0; i < found; i++) symbols[i] = tables.takeSymbol(stream, contexts[i], i < whole ? i & 3 : 0);
      tables.learn(contexts, found);
      for (let i = 0; i < found; i++) {
        const magnitude = stream.takeMagnitude(symbols[i], shifts[i], shifts[i] === 4 ? 4 : 0);
        if (!magnitude) continue;
        const at = places[i];
        out[at] = stream.takeBits(1) ? -magnitude : magnitude;
        const y = Math.floor(at / columns);
        sizes[(y + 1) * PITCH + (at - y * columns) + 1] = Math.min(magnitude, 255);
      }
    }
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
        for (let x = left + odd; x < right; x += 2) places[found++] = y * columns + x;
      }
    }
    return found;
  }

  function addContext(i, columns, group, batch, sizes) {
    const at = places[i];
    const known = hint[at];
    let expected = known >> 4;
    let near = 11;
    if (batch) {
      const y = Math.floor(at / columns);
      const here = (y + 1) * PITCH + (at - y * columns) + 1;
      const [a, b, c, d] = NEIGHBOURS[batch];
      const around = sizes[here + a] + sizes[here + b] + sizes[here + c] + sizes[here + d];
      near = Math.min(classOf(around), 10);
      expected = Math.max(expected, around >> 2);
    }
    contexts[i] = 192 * group + 16 * near + Math.min(classOf(known), 15);
    shifts[i] = Math.max(bitsOf(expected) - 4, 0);
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
