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
  /** Radiance of code values up to 2, between which it is a straight line: to 4e-8. */
  const curveTable = () => (table ??= Float64Array.from({ length: STEPS + 2 }, (_, i) => unbent((i * MOST) / STEPS)));

  /**
   * Texels of coefficients, those of coefficient k and channel c being plane k C + c, of texels of a payload's planes.
   *
   * `evaluation` [node][channel][plane, and 1] makes code values at the nodes, `analysis` [coefficient][node] makes
   * coefficients of radiance there: docs/bitstream.md, klt.
   */
  function straighten(texels, pixels, { planes, channels, evaluation, analysis }) {
    const width = planes + 1;
    const rows = evaluation.length / width;
    const nodes = rows / channels;
    const count = analysis.length / nodes;
    demand(texels.length === 4 * Math.ceil(planes / 4) * pixels, "texels of another size");
    const [values, curve] = [halfFloats(), curveTable()];
    const out = new Uint16Array(4 * Math.ceil((count * channels) / 4) * pixels);
    const given = new Float64Array(TOGETHER * width).fill(1);
    const radiance = new Float64Array(TOGETHER * rows);
    const scale = STEPS / MOST;
    const straight = (value) => {
      const place = Math.abs(value) * scale;
      if (!(place < STEPS)) return unbent(value);
      const i = place | 0;
      const found = curve[i] + (place - i) * (curve[i + 1] - curve[i]);
      return value < 0 ? -found : found;
    };
    for (let first = 0; first < pixels; first += TOGETHER) {
      const some = Math.min(TOGETHER, pixels - first);
      for (let j = 0; j < planes; j++) {
        const from = ((j >> 2) * pixels + first) * 4 + (j & 3);
        for (let q = 0; q < some; q++) given[TOGETHER * j + q] = values[texels[from + 4 * q]];
      }
      for (let r = 0, at = 0; r < rows; r++) {
        let [a, b, c, d] = [0, 0, 0, 0];
        for (let j = 0; j < given.length; j += TOGETHER) {
          const weight = evaluation[at++];
          a += weight * given[j];
          b += weight * given[j + 1];
          c += weight * given[j + 2];
          d += weight * given[j + 3];
        }
        const to = TOGETHER * r;
        radiance[to] = straight(a);
        radiance[to + 1] = straight(b);
        radiance[to + 2] = straight(c);
        radiance[to + 3] = straight(d);
      }
      for (let k = 0; k < count; k++)
        for (let channel = 0; channel < channels; channel++) {
          let [a, b, c, d] = [0, 0, 0, 0];
          for (let i = 0, from = TOGETHER * channel; i < nodes; i++, from += TOGETHER * channels) {
            const weight = analysis[k * nodes + i];
            a += weight * radiance[from];
            b += weight * radiance[from + 1];
            c += weight * radiance[from + 2];
            d += weight * radiance[from + 3];
          }
          const plane = k * channels + channel;
          const to = ((plane >> 2) * pixels + first) * 4 + (plane & 3);
          const made = [a, b, c, d];
          for (let q = 0; q < some; q++) out[to + 4 * q] = toHalf(made[q]);
        }
    }
    return out;
  }

  Object.assign(clrelight, { straighten });
})();
