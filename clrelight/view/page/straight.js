// Planes behind the sRGB curve as planes of coefficients, once for a tile: then any light is one sum, as of other files.
"use strict";
(() => {
  const clrelight = (globalThis.clrelight ??= {});
  const { fromHalf, toHalf, demand } = clrelight;

  const TOGETHER = 4; // pixels for which a weight is read once

  let floats = null;
  /** All 16-bit floats. */
  const halfFloats = () => (floats ??= Float64Array.from({ length: 1 << 16 }, (_, bits) => fromHalf(bits)));

  /** Radiance of a code value, below 0 that of its magnitude: the sRGB curve. */
  function unbent(value) {
    const size = Math.abs(value);
    const radiance = size <= 0.04045 ? size / 12.92 : ((size + 0.055) / 1.055) ** 2.4;
    return value < 0 ? -radiance : radiance;
  }

  const STEPS = 8192;
  const MOST = 2;
  let table = null;

  /** The curve for values up to 2, between entries of a table a straight line: to 4e-8. */
  function straightener() {
    const curve = (table ??= Float64Array.from({ length: STEPS + 2 }, (_, i) => unbent((i * MOST) / STEPS)));
    return (value) => {
      const place = Math.abs(value) * (STEPS / MOST);
      if (!(place < STEPS)) return unbent(value);
      const i = place | 0;
      const found = curve[i] + (place - i) * (curve[i + 1] - curve[i]);
      return value < 0 ? -found : found;
    };
  }

  /** Cosines [m][a] or sines of m times azimuth a of 2 D + 1, both from 0 to D. */
  function waves(degree, wave) {
    const side = degree + 1;
    return Float64Array.from({ length: side * side }, (_, i) => {
      return wave((2 * Math.PI * ((Math.floor(i / side) * (i % side)) % (2 * degree + 1))) / (2 * degree + 1));
    });
  }

  /**
   * Coefficients of values at the nodes of the product rule, of a channel for `TOGETHER` pixels.
   *
   * `columns` [l and m >= 0][height] are what projects functions of height; azimuth is a Fourier sum before. Values a
   * and -a share what is even and what is odd in azimuth, so that each is half as long.
   */
  class Projection {
    constructor(columns, degree) {
      Object.assign(this, { columns, degree, cosines: waves(degree, Math.cos), sines: waves(degree, Math.sin) });
      const side = degree + 1;
      this.even = new Float64Array(TOGETHER * side);
      this.odd = new Float64Array(TOGETHER * side);
      this.waves = [0, 1].map(() => new Float64Array(TOGETHER * side * side)); // [m][height], of cosines and of sines
      this.found = new Float64Array(TOGETHER * side * side);
    }

    /** Values [height][azimuth], `stride` numbers from one to the next; returns coefficients [k][pixel]. */
    project(values, start, stride) {
      const side = this.degree + 1;
      const around = 2 * side - 1;
      for (let h = 0; h < side; h++) {
        const first = start + h * around * stride;
        this.split(values, first, stride);
        for (let m = 0; m < side; m++) {
          sumInto(this.waves[0], TOGETHER * (m * side + h), this.cosines, m * side, this.even, 0, side);
          if (m) sumInto(this.waves[1], TOGETHER * (m * side + h), this.sines, m * side, this.odd, 0, side);
        }
      }
      for (let l = 0, row = 0; l < side; l++)
        for (let m = 0; m <= l; m++, row++) {
          const place = TOGETHER * m * side;
          sumInto(this.found, TOGETHER * (l * l + l + m), this.columns, row * side, this.waves[0], place, side);
          if (m) sumInto(this.found, TOGETHER * (l * l + l - m), this.columns, row * side, this.waves[1], place, side);
        }
      return this.found;
    }

    /** What is even and what is odd in azimuth, of a height. */
    split(values, first, stride) {
      const { even, odd, degree } = this;
      for (let q = 0; q < TOGETHER; q++) even[q] = values[first + q];
      for (let a = 1; a <= degree; a++)
        for (let q = 0; q < TOGETHER; q++) {
          const one = values[first + a * stride + q];
          const other = values[first + (2 * degree + 1 - a) * stride + q];
          even[TOGETHER * a + q] = one + other;
          odd[TOGETHER * a + q] = one - other;
        }
    }
  }

  /** Set out[to + pixel] to the sum over i < count of weights[from + i] values[at + i][pixel]. */
  function sumInto(out, to, weights, from, values, at, count) {
    let [a, b, c, d] = [0, 0, 0, 0];
    for (let i = from, j = at; i < from + count; i++, j += TOGETHER) {
      const weight = weights[i];
      a += weight * values[j];
      b += weight * values[j + 1];
      c += weight * values[j + 2];
      d += weight * values[j + 3];
    }
    out[to] = a;
    out[to + 1] = b;
    out[to + 2] = c;
    out[to + 3] = d;
  }

  /**
   * Texels of coefficients, those of coefficient k and channel c being plane k C + c, of texels of a payload's planes.
   *
   * `evaluation` [node][channel][plane, and 1] makes code values at the nodes of the product rule, `columns` [l and
   * m >= 0][height] coefficients of radiance there: docs/bitstream.md, klt.
   */
  function straighten(texels, pixels, { planes, channels, evaluation, columns, degree }) {
    const width = planes + 1;
    const rows = evaluation.length / width;
    const count = (degree + 1) ** 2;
    demand(texels.length === 4 * Math.ceil(planes / 4) * pixels, "texels of another size");
    const [values, radianceOf] = [halfFloats(), straightener()];
    const out = new Uint16Array(4 * Math.ceil((count * channels) / 4) * pixels);
    const given = new Float64Array(TOGETHER * width).fill(1);
    const radiance = new Float64Array(TOGETHER * rows);
    const projection = new Projection(columns, degree);
    for (let first = 0; first < pixels; first += TOGETHER) {
      const some = Math.min(TOGETHER, pixels - first);
      for (let j = 0; j < planes; j++) {
        const from = ((j >> 2) * pixels + first) * 4 + (j & 3);
        for (let q = 0; q < some; q++) given[TOGETHER * j + q] = values[texels[from + 4 * q]];
      }
      for (let r = 0; r < rows; r++) sumInto(radiance, TOGETHER * r, evaluation, r * width, given, 0, width);
      for (let i = 0; i < radiance.length; i++) radiance[i] = radianceOf(radiance[i]);
      for (let channel = 0; channel < channels; channel++) {
        const found = projection.project(radiance, TOGETHER * channel, TOGETHER * channels);
        for (let k = 0; k < count; k++) {
          const plane = k * channels + channel;
          const to = ((plane >> 2) * pixels + first) * 4 + (plane & 3);
          for (let q = 0; q < some; q++) out[to + 4 * q] = toHalf(found[TOGETHER * k + q]);
        }
      }
    }
    return out;
  }

  Object.assign(clrelight, { straighten });
})();
