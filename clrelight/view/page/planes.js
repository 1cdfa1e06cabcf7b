// Planes of a part of the image at a level: the inverse 9/7 transform of units, and planes as texels of 16-bit floats.
"use strict";
(() => {
  const clrelight = (globalThis.clrelight ??= {});
  const { demand, bandShapes, halved, toHalf, LEVELS } = clrelight;

  const LOW = 1 / 1.149604398860241;
  const HIGH = 1 / 0.869864451624781;
  // Of each step the factor, and whether odd samples change.
  const STEPS = [
    [0.443506852043971, 0],
    [0.882911075530934, 1],
    [-0.052980118572961, 0],
    [-1.586134342059924, 1],
  ];
  const MARGIN = 3;
  const MOST_VALUES = 2 ** 28;

  /** Undo a level along the rows of interleaved samples, which go on beyond their ends as their mirror image. */
  function joinRows(values, rows, columns) {
    if (columns === 1) return;
    for (let row = 0; row < rows; row++) {
      const first = row * columns;
      const last = first + columns - 1;
      for (const [factor, odd] of STEPS) {
        if (!odd) values[first] -= 2 * factor * values[first + 1];
        for (let at = first + 2 - odd; at < last; at += 2) values[at] -= factor * (values[at - 1] + values[at + 1]);
        if ((columns - 1) % 2 === odd) values[last] -= 2 * factor * values[last - 1];
      }
    }
  }

  /** Undo a level along the columns. */
  function joinColumns(values, rows, columns) {
    if (rows === 1) return;
    for (const [factor, odd] of STEPS) {
      for (let row = odd; row < rows; row += 2) {
        const here = row * columns;
        const before = (row > 0 ? row - 1 : 1) * columns;
        const after = (row < rows - 1 ? row + 1 : row - 1) * columns;
        for (let x = 0; x < columns; x++) values[here + x] -= factor * (values[before + x] + values[after + x]);
      }
    }
  }

  /** Of samples [begin, end) of a level, those of the subbands one level down that they hang on. */
  function below([begin, end], side) {
    return [Math.max((begin >> 1) - MARGIN, 0), Math.min(((end + 1) >> 1) + MARGIN, side)];
  }

  /** What lies where, from the region's level down to the fifth. */
  function planRegion(units, level, [top, bottom], [left, right]) {
    const spans = [];
    let [rows, columns] = [[top, bottom], [left, right]];
    for (let depth = level + 1; depth <= LEVELS; depth++) {
      rows = below(rows, halved(units.height, depth));
      columns = below(columns, halved(units.width, depth));
      spans[depth] = { rows, columns };
    }
    return { level, spans, region: { rows: [top, bottom], columns: [left, right] }, deepest: { rows, columns } };
  }

  /** Numbers of the units that a plan hangs on. */
  function unitsOf(units, plan) {
    const numbers = [];
    const add = (level, { rows, columns }) => {
      const { side, first, rows: most, columns: across } = units.grids[level];
      const lastRow = Math.min(Math.floor((rows[1] - 1) / side), most - 1);
      const lastColumn = Math.min(Math.floor((columns[1] - 1) / side), across - 1);
      for (let row = Math.floor(rows[0] / side); row <= lastRow; row++)
        for (let column = Math.floor(columns[0] / side); column <= lastColumn; column++)
          numbers.push(first + row * across + column);
    };
    add(0, plan.deepest);
    for (let depth = LEVELS; depth > plan.level; depth--) add(depth, plan.spans[depth]);
    return numbers;
  }

  /** Put a subband's samples of a window into `out` from a place on, every `step`-th row and column, times a factor. */
  function spread(units, level, band, plane, window, out, { pitch, start, step }, factor) {
    const { side, rows: unitRows, columns: unitColumns } = units.grids[level];
    const [y0, y1] = window.rows;
    const [x0, x1] = window.columns;
    for (let top = Math.floor(y0 / side) * side; top < y1 && top < unitRows * side; top += side)
      for (let left = Math.floor(x0 / side) * side; left < x1 && left < unitColumns * side; left += side) {
        const number = units.numberOf(level, top, left);
        const shape = units.place(number).bands[band];
        if (!shape) continue;
        const { values, live } = units.kept.get(number).bands[band];
        if (!live[plane]) continue;
        const offset = plane * shape.rows * shape.columns;
        for (let y = Math.max(top, y0); y < Math.min(top + shape.rows, y1); y++) {
          const from = offset + (y - top) * shape.columns - left;
          const to = start + step * ((y - y0) * pitch - x0);
          const end = Math.min(left + shape.columns, x1);
          for (let x = Math.max(left, x0); x < end; x++) out[to + step * x] = factor * values[from + x];
        }
      }
  }

  /** Zeros of a size, the same memory each time: planes are made one after another. */
  function cleared(scratch, depth, size) {
    const found = scratch[depth];
    if (!found || found.length !== size) return (scratch[depth] = new Float32Array(size));
    return found.fill(0);
  }

  /** What a level's window becomes: rows and columns of the next finer level. */
  function grown({ rows, columns }, height, width) {
    return {
      rows: [2 * rows[0], Math.min(2 * rows[1], height)],
      columns: [2 * columns[0], Math.min(2 * columns[1], width)],
    };
  }

  /** Samples of one plane, whose units are decoded: {values, window}, of which the window holds the plan's region. */
  function joinPlane(units, plan, plane, scratch = []) {
    let window = plan.deepest;
    const sides = ({ rows, columns }) => [rows[1] - rows[0], columns[1] - columns[0]];
    let [h, w] = sides(window);
    let values = cleared(scratch, 0, h * w);
    spread(units, 0, 0, plane, window, values, { pitch: w, start: 0, step: 1 }, 1);
    for (let depth = LEVELS; depth > plan.level; depth--) {
      const low = plan.spans[depth];
      const next = grown(low, halved(units.height, depth - 1), halved(units.width, depth - 1));
      const from = (low.rows[0] - window.rows[0]) * w + low.columns[0] - window.columns[0];
      const pitch = w;
      [h, w] = sides(next);
      const out = cleared(scratch, depth, h * w);
      // A line of one sample stays as it is.
      const [lowY, highY] = h === 1 ? [1, 1] : [LOW, HIGH];
      const [lowX, highX] = w === 1 ? [1, 1] : [LOW, HIGH];
      const [lowRows, lowColumns] = sides(low);
      for (let y = 0; y < lowRows; y++) {
        const [source, target] = [from + y * pitch, 2 * y * w];
        for (let x = 0; x < lowColumns; x++) out[target + 2 * x] = lowY * lowX * values[source + x];
      }
      const factors = [lowY * highX, highY * lowX, highY * highX];
      const starts = [1, w, w + 1];
      const shapes = bandShapes(units.height, units.width, depth);
      for (let b = 0; b < 3; b++) {
        const part = {
          rows: [low.rows[0], Math.min(low.rows[1], shapes[b].height)],
          columns: [low.columns[0], Math.min(low.columns[1], shapes[b].width)],
        };
        spread(units, depth, b, plane, part, out, { pitch: w, start: starts[b], step: 2 }, factors[b]);
      }
      joinRows(out, h, w);
      joinColumns(out, h, w);
      [values, window] = [out, next];
    }
    return { values, window };
  }

  /**
   * Texels of a region: 16-bit floats [layer, row, column, 4], four planes to a layer, each plane times its scale.
   *
   * The image at a level is the low subband there times 2^-level.
   */
  async function decodeRegion(units, level, top, left, bottom, right, scales) {
    const rows = bottom - top;
    const columns = right - left;
    demand(0 <= top && top < bottom && bottom <= halved(units.height, level), "no such rows");
    demand(0 <= left && left < right && right <= halved(units.width, level), "no such columns");
    const layers = Math.ceil(units.planes / 4);
    demand(4 * layers * rows * columns <= MOST_VALUES, "a region is too large");
    const plan = planRegion(units, level, [top, bottom], [left, right]);
    await units.need(unitsOf(units, plan));
    const texels = new Uint16Array(4 * layers * rows * columns);
    const scratch = [];
    for (let plane = 0; plane < units.planes; plane++) {
      const factor = scales[plane] * 0.5 ** level;
      const { values, window } = joinPlane(units, plan, plane, scratch);
      const pitch = window.columns[1] - window.columns[0];
      let to = (plane >> 2) * rows * columns * 4 + (plane & 3);
      for (let y = top - window.rows[0]; y < bottom - window.rows[0]; y++) {
        const first = y * pitch + left - window.columns[0];
        for (let x = 0; x < columns; x++, to += 4) texels[to] = toHalf(factor * values[first + x]);
      }
    }
    units.makeRoom();
    return texels;
  }

  Object.assign(clrelight, { decodeRegion, joinPlane, planRegion, unitsOf });
})();
