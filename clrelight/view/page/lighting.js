// From what the controls say to weights of planes: out = sum_i W_i plane_i, behind the curve where a payload has one.
"use strict";
(() => {
  const clrelight = (globalThis.clrelight ??= {});
  const { evaluateBasis, turnAboutZ, capWindow, capDirections, productRule, indexOf, floatsOf } = clrelight;

  const RADIANS = Math.PI / 180;
  const SAMPLES = 128; // of a soft lamp that reaches below the horizon
  const BENT_SAMPLES = 24; // of a soft lamp behind a curve: each is a sum over all planes

  const degreeAndOrder = (k) => {
    const l = Math.floor(Math.sqrt(k));
    return [l, k - indexOf(l, 0)];
  };

  /** Where the sun stands, or the lamp. */
  function sunDirection({ height, azimuth }, standing) {
    const across = Math.cos(height * RADIANS);
    const [x, y, z] = [across * Math.cos(azimuth * RADIANS), across * Math.sin(azimuth * RADIANS), Math.sin(height * RADIANS)];
    return standing ? [x, z, -y] : [x, y, z];
  }

  /** A soft lamp as directions above the horizon. */
  function lampDirections(direction, softness, count) {
    if (softness < 0.5) return [direction];
    const above = capDirections(direction, softness * RADIANS, count).filter((each) => each[2] > 0);
    return above.length ? above : [direction];
  }

  /** Factors of coefficients [k] of a lamp: its basis functions, windowed where all of it is above the horizon. */
  function lampCoefficients(direction, softness, degree) {
    const elevation = Math.asin(Math.min(Math.max(direction[2], -1), 1));
    if (softness * RADIANS <= elevation) {
      const window = capWindow(softness * RADIANS, degree);
      return evaluateBasis(direction, degree).map((value, k) => value * window[Math.floor(Math.sqrt(k))]);
    }
    const directions = lampDirections(direction, softness, SAMPLES);
    const sum = new Float64Array((degree + 1) ** 2);
    for (const each of directions) evaluateBasis(each, degree).forEach((value, k) => (sum[k] += value / directions.length));
    return sum;
  }

  /** What lights a picture: lights of the manifest, and what fits see of them. */
  class Lighting {
    constructor(manifest) {
      this.degree = manifest.light_degree;
      this.skies = manifest.skies.map((sky) => ({ ...sky, table: floatsOf(sky.table) }));
      this.environments = manifest.environments.map((each) => ({ ...each, table: floatsOf(each.table) }));
      this.views = new Map();
    }

    /** Coefficients of a sky, its sun at azimuth 0, between the heights of the table. */
    skyAt(index, height) {
      const { heights, table } = this.skies[index];
      const count = (this.degree + 1) ** 2;
      const half = ((this.degree + 1) * (this.degree + 2)) / 2; // orders from 0 on
      const place = heights.length > 1 ? (height / heights[heights.length - 1]) * (heights.length - 1) : 0;
      const low = Math.min(Math.floor(place), Math.max(heights.length - 2, 0));
      const share = place - low;
      return Float64Array.from({ length: count }, (_, k) => {
        const [l, m] = degreeAndOrder(k);
        if (m < 0) return 0; // a sky is the same on both sides of its sun
        const at = (row) => table[row * half + (l * (l + 1)) / 2 + m];
        return share ? at(low) + share * (at(low + 1) - at(low)) : at(low);
      });
    }

    /** Basis functions [node][k] at directions of the picture's upper hemisphere, and at the same about the zenith. */
    viewOf(standing) {
      if (!this.views.has(standing)) {
        const { directions, weights } = productRule(this.degree);
        const list = Array.from(weights, (_, i) => [...directions.subarray(3 * i, 3 * i + 3)]);
        const rows = (place) => list.map((direction) => evaluateBasis(place(direction), this.degree));
        const here = rows((direction) => direction);
        this.views.set(standing, { weights, here, there: standing ? rows(([x, y, z]) => [x, -z, y]) : here });
      }
      return this.views.get(standing);
    }

    /** What fits up to a degree see of light [k][channel] about its zenith: [k][channel], 3 channels. */
    seen(light, channels, standing, degree) {
      const { weights, here, there } = this.viewOf(standing);
      const [wide, count] = [(this.degree + 1) ** 2, (degree + 1) ** 2];
      const found = new Float64Array(3 * count);
      const sums = new Float64Array(channels);
      weights.forEach((weight, i) => {
        sums.fill(0);
        for (let j = 0, at = 0; j < wide; j++) for (let c = 0; c < channels; c++) sums[c] += there[i][j] * light[at++];
        for (let k = 0; k < count; k++)
          for (let c = 0; c < 3; c++) found[3 * k + c] += weight * here[i][k] * sums[channels === 3 ? c : 0];
      });
      return found;
    }

    /** Light from everywhere as fits of a degree see it, and the sun beside a sky: {seen, sun, share}. */
    surroundings(state, degree) {
      if (state.light === "sky") {
        const { table, height, azimuth, sun } = state.sky;
        const share = height > 0 ? sun : 0;
        const turned = turnAboutZ(this.skyAt(table, height), 1, azimuth * RADIANS);
        const seen = this.seen(turned, 1, state.standing, degree).map((value) => value * (1 - share));
        return { seen, sun: sunDirection(state.sky, state.standing), share };
      }
      const { table, channels } = this.environments[state.environment.table];
      const turned = turnAboutZ(table, channels, state.environment.turn * RADIANS);
      return { seen: this.seen(turned, channels, state.standing, degree), sun: null, share: 0 };
    }

    /** Factors of coefficients [k][channel], 3 channels. */
    coefficients(state, degree) {
      const count = (degree + 1) ** 2;
      if (state.light === "lamp") {
        const lamp = lampCoefficients(state.lamp.direction, state.lamp.softness, degree);
        return Float64Array.from({ length: 3 * count }, (_, i) => lamp[Math.floor(i / 3)]);
      }
      const { seen, sun, share } = this.surroundings(state, degree);
      if (share && sun[2] > 0) {
        const direct = lampCoefficients(sun, state.lamp.softness, degree);
        for (let i = 0; i < seen.length; i++) seen[i] += share * direct[Math.floor(i / 3)];
      }
      return seen;
    }

    /** Directions and what each channel takes of their radiance: {direction, share: [r, g, b]}. */
    nodes(state, file) {
      const lamp = (direction, share) => {
        const directions = lampDirections(direction, state.lamp.softness, BENT_SAMPLES);
        return directions.map((each) => ({ direction: each, share: Array(3).fill(share / directions.length) }));
      };
      if (state.light === "lamp") return lamp(state.lamp.direction, 1);
      const { seen, sun, share } = this.surroundings(state, file.degree);
      const count = file.nodes.length / 3;
      const found = Array.from({ length: count }, (_, i) => {
        const sums = [0, 0, 0];
        for (let k = 0; 3 * k < seen.length; k++)
          for (let c = 0; c < 3; c++) sums[c] += seen[3 * k + c] * file.analysis[k * count + i];
        return { direction: [...file.nodes.subarray(3 * i, 3 * i + 3)], share: sums };
      });
      const most = Math.max(...found.map((node) => Math.max(...node.share.map(Math.abs))));
      const seenNodes = found.filter((node) => node.share.some((each) => Math.abs(each) > 1e-4 * most));
      return share && sun[2] > 0 ? [...seenNodes, ...lamp(sun, share)] : seenNodes;
    }
  }

  /** Weights of planes [channel][plane, and 1], of factors of coefficients [k][channel] for a file. */
  function planeWeights(file, factors) {
    const { planes, channels } = file;
    const width = planes + 1;
    const weights = new Float32Array(3 * width);
    const count = factors.length / 3;
    for (let c = 0; c < 3; c++) {
      const own = channels === 3 ? c : 0;
      if (!file.operator) {
        for (let k = 0; k < count; k++) weights[c * width + k * channels + own] = factors[3 * k + c];
        continue;
      }
      for (let i = 0; i < width; i++) {
        let sum = 0;
        for (let k = 0; k < count; k++) sum += factors[3 * k + c] * file.operator[(k * channels + own) * width + i];
        weights[c * width + i] = sum;
      }
    }
    return weights;
  }

  /** What makes code values at a payload's nodes of its planes, [node][channel][plane, and 1]. */
  function evaluationOf({ nodes, channels, planes, operator, degree }) {
    const [count, width] = [nodes.length / 3, planes + 1];
    const found = new Float64Array(count * channels * width);
    for (let i = 0; i < count; i++)
      evaluateBasis([...nodes.subarray(3 * i, 3 * i + 3)], degree).forEach((value, k) => {
        for (let j = 0; j < channels * width; j++)
          found[i * channels * width + j] += value * operator[k * channels * width + j];
      });
    return found;
  }

  /** Whether a light is one lamp without extent, the only one that a payload behind the curve shows as one sum. */
  const isOneDirection = ({ light, lamp }) => light === "lamp" && lamp.softness < 0.5;

  const ALL = { share: [1, 1, 1] };

  /** What a file's planes are summed with: {bent, nodes: [{weights, share}]}. */
  function weightsOf(lighting, state, file) {
    if (file.kind === "photographs") {
      const weights = new Float32Array(3 * (file.channels + 1));
      for (let c = 0; c < 3; c++) weights[c * (file.channels + 1) + (file.channels === 3 ? c : 0)] = 1;
      return { bent: false, nodes: [{ weights, ...ALL }] };
    }
    if (!file.bent) {
      const factors = lighting.coefficients(state, file.degree);
      return { bent: false, nodes: [{ weights: planeWeights(file, factors), ...ALL }] };
    }
    const nodes = lighting.nodes(state, file).map(({ direction, share }) => {
      const basis = evaluateBasis(direction, file.degree);
      const factors = Float64Array.from({ length: 3 * basis.length }, (_, i) => basis[Math.floor(i / 3)]);
      return { weights: planeWeights(file, factors), share };
    });
    return { bent: true, nodes };
  }

  Object.assign(clrelight, { Lighting, weightsOf, planeWeights, evaluationOf, isOneDirection, sunDirection, lampCoefficients, RADIANS });
})();
