// Figures of what is shown: how far two pictures are apart, and the exposure that hardly clips anything.
"use strict";
(() => {
  const clrelight = (globalThis.clrelight ??= {});

  const BINS = 4096;

  const encode = (v) => (v <= 0.0031308 ? 12.92 * v : 1.055 * v ** (1 / 2.4) - 0.055);
  const clip = (v) => (v > 0 ? Math.min(v, 1) : 0);

  /** PSNR in decibel of display values of peak 1, where both pictures are; by the sRGB curve or none. NaN of nothing. */
  function decibelsApart(first, second, transfer) {
    const curve = transfer === "srgb" ? encode : (v) => v;
    let [sum, count] = [0, 0];
    const [a, b] = [first.values, second.values];
    for (let i = 0; i < a.length; i += 4) {
      if (a[i + 3] < 1 || b[i + 3] < 1) continue;
      for (let c = 0; c < 3; c++) sum += (curve(clip(a[i + c])) - curve(clip(b[i + c]))) ** 2;
      count += 3;
    }
    return count ? -10 * Math.log10(sum / count) : NaN;
  }

  /** Stops that make the 99th percentile of the brightest channel white; 0 of a black picture. */
  function automaticExposure({ values }) {
    const largest = [];
    for (let i = 0; i < values.length; i += 4) {
      if (values[i + 3] === 1) largest.push(Math.max(values[i], values[i + 1], values[i + 2]));
    }
    const white = percentile(largest, 0.99);
    return white > 0 ? -Math.log2(white) : 0;
  }

  function percentile(values, share) {
    const most = values.reduce((a, b) => Math.max(a, b), 0);
    if (!(most > 0)) return 0;
    const counts = new Uint32Array(BINS + 1);
    for (const value of values) counts[value > 0 ? Math.floor((value / most) * BINS) : 0]++;
    let left = share * values.length;
    let bin = 0;
    while (bin < BINS && (left -= counts[bin]) > 0) bin++;
    return ((bin + 0.5) / BINS) * most;
  }

  /** A number of bytes as people read it. */
  function bytesText(count) {
    for (const [unit, size] of [["GB", 1e9], ["MB", 1e6], ["kB", 1e3]]) {
      if (count >= size) return `${(count / size).toPrecision(3)} ${unit}`;
    }
    return `${count} bytes`;
  }

  Object.assign(clrelight, { decibelsApart, automaticExposure, bytesText });
})();
