// What the controls say when the page opens.
"use strict";
(() => {
  const clrelight = (globalThis.clrelight ??= {});
  const { directionOf } = clrelight;

  const START = {
    light: "lamp",
    lamp: { direction: directionOf(-0.45, 0.5), softness: 0 },
    sky: { table: 0, height: 40, azimuth: 135, sun: 0.6 },
    environment: { table: 0, turn: 0 },
    standing: false,
    exposure: 0,
    curve: "srgb",
    compare: "one",
    first: 0,
    second: 0,
    split: 0.5,
    errorGain: 4,
    photograph: 0,
    tool: "light",
  };

  Object.assign(clrelight, { START });
})();
