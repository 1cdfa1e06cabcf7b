// Real spherical harmonics as clrelight has them: orthonormal on the sphere, no Condon-Shortley sign, k = l (l + 1) + m.
"use strict";
(() => {
  const clrelight = (globalThis.clrelight ??= {});

  const indexOf = (l, m) => l * (l + 1) + m;

  /** y_k of a unit vector up to a degree. */
  function evaluateBasis([x, y, z], degree) {
    const values = new Float64Array((degree + 1) ** 2);
    let sectoral = Math.sqrt(1 / (4 * Math.PI)); // without the power of the sine, which cosine and sine bring along
    let [cosine, sine] = [1, 0];
    for (let m = 0; m <= degree; m++) {
      if (m > 0) {
        sectoral *= Math.sqrt((2 * m + 1) / (2 * m));
        [cosine, sine] = [cosine * x - sine * y, cosine * y + sine * x];
      }
      let [before, now] = [0, sectoral];
      for (let l = m; l <= degree; l++) {
        if (l > m) {
          const down = Math.sqrt(((l - 1) ** 2 - m * m) / (4 * (l - 1) ** 2 - 1));
          const up = Math.sqrt((4 * l * l - 1) / (l * l - m * m));
          [before, now] = [now, up * (z * now - (l > m + 1 ? down * before : 0))];
        }
        if (m === 0) values[indexOf(l, 0)] = now;
        else {
          values[indexOf(l, m)] = Math.SQRT2 * now * cosine;
          values[indexOf(l, -m)] = Math.SQRT2 * now * sine;
        }
      }
    }
    return values;
  }

  /** Coefficients [k][channel] turned about z by an angle in radians, counterclockwise seen from +z. */
  function turnAboutZ(coefficients, channels, angle) {
    const degree = Math.round(Math.sqrt(coefficients.length / channels)) - 1;
    const turned = Float64Array.from(coefficients);
    for (let m = 1; m <= degree; m++) {
      const [cosine, sine] = [Math.cos(m * angle), Math.sin(m * angle)];
      for (let l = m; l <= degree; l++)
        for (let c = 0; c < channels; c++) {
          const [plus, minus] = [indexOf(l, m) * channels + c, indexOf(l, -m) * channels + c];
          turned[plus] = cosine * coefficients[plus] - sine * coefficients[minus];
          turned[minus] = sine * coefficients[plus] + cosine * coefficients[minus];
        }
    }
    return turned;
  }

  /** What a cap of an opening angle makes of each degree, 1 of a lamp without extent: the mean over it (Funk-Hecke). */
  function capWindow(angle, degree) {
    const factors = new Float64Array(degree + 1).fill(1);
    if (angle < 1e-4) return factors;
    const z = Math.cos(angle);
    const legendre = [1, z];
    for (let l = 2; l <= degree + 1; l++) legendre[l] = ((2 * l - 1) * z * legendre[l - 1] - (l - 1) * legendre[l - 2]) / l;
    for (let l = 1; l <= degree; l++) factors[l] = (legendre[l - 1] - legendre[l + 1]) / ((2 * l + 1) * (1 - z));
    return factors;
  }

  /** Directions spread evenly over a cap about a direction. */
  function capDirections([x, y, z], angle, count) {
    const side = Math.abs(z) < 0.9 ? [-y, x, 0] : [0, -z, y];
    const length = Math.hypot(...side);
    const u = side.map((v) => v / length);
    const v = [y * u[2] - z * u[1], z * u[0] - x * u[2], x * u[1] - y * u[0]];
    const golden = Math.PI * (3 - Math.sqrt(5));
    return Array.from({ length: count }, (_, i) => {
      const height = 1 - ((i + 0.5) / count) * (1 - Math.cos(angle));
      const [across, turn] = [Math.sqrt(1 - height * height), i * golden];
      const [a, b] = [across * Math.cos(turn), across * Math.sin(turn)];
      return [0, 1, 2].map((j) => height * [x, y, z][j] + a * u[j] + b * v[j]);
    });
  }

  /** Gauss's rule on 0 to 1: [nodes, weights], exact for polynomials of degrees below twice their count. */
  function gaussRule(count) {
    const [nodes, weights] = [new Float64Array(count), new Float64Array(count)];
    for (let i = 0; i < count; i++) {
      let x = -Math.cos((Math.PI * (i + 0.75)) / (count + 0.5));
      let slope;
      for (let step = 0; step < 8; step++) {
        let [before, now] = [1, x];
        for (let l = 2; l <= count; l++) [before, now] = [now, ((2 * l - 1) * x * now - (l - 1) * before) / l];
        slope = (count * (x * now - before)) / (x * x - 1);
        x -= now / slope;
      }
      nodes[i] = (x + 1) / 2;
      weights[i] = 1 / ((1 - x * x) * slope * slope);
    }
    return [nodes, weights];
  }

  /** Directions [node][3] and solid angles of the upper hemisphere, exact for products of two functions of a degree. */
  function productRule(degree) {
    const [heights, shares] = gaussRule(degree + 1);
    const around = 2 * degree + 1;
    const directions = new Float64Array(3 * heights.length * around);
    const weights = new Float64Array(heights.length * around);
    heights.forEach((z, q) => {
      for (let a = 0; a < around; a++) {
        const [across, azimuth] = [Math.sqrt(1 - z * z), (2 * Math.PI * a) / around];
        directions.set([across * Math.cos(azimuth), across * Math.sin(azimuth), z], 3 * (q * around + a));
        weights[q * around + a] = (shares[q] * 2 * Math.PI) / around;
      }
    });
    return { directions, weights };
  }

  /**
   * A matrix [k][node of the product rule] of its columns at azimuth 0, of orders from 0 on: [l and m][height].
   *
   * What is symmetric about z depends on azimuth as y_k does, by the cosine or the sine of m times it.
   */
  function spreadOverAzimuths(columns, degree) {
    const [heights, around] = [degree + 1, 2 * degree + 1];
    const matrix = new Float64Array((degree + 1) ** 2 * heights * around);
    for (let l = 0, row = 0; l <= degree; l++)
      for (let m = 0; m <= l; m++, row++)
        for (let q = 0; q < heights; q++)
          for (let a = 0; a < around; a++) {
            const angle = (2 * Math.PI * m * a) / around;
            const at = (k) => (k * heights + q) * around + a;
            matrix[at(indexOf(l, m))] = columns[row * heights + q] * Math.cos(angle);
            if (m) matrix[at(indexOf(l, -m))] = columns[row * heights + q] * Math.sin(angle);
          }
    return matrix;
  }

  Object.assign(clrelight, { evaluateBasis, turnAboutZ, capWindow, capDirections, productRule, spreadOverAzimuths, indexOf });
})();
