// Shaders: sums of planes into linear radiance, and radiance onto the screen.
"use strict";
(() => {
  const clrelight = (globalThis.clrelight ??= {});

  const VERTEX = `#version 300 es
uniform vec4 uPlace;    // left, bottom, right, top on the screen, -1 to 1
uniform vec4 uTexture;  // the same corners in the tile, 0 to 1
out vec2 vTexture;
void main() {
  vec2 corner = vec2(gl_VertexID & 1, gl_VertexID >> 1);
  vTexture = mix(uTexture.xy, uTexture.zw, corner);
  gl_Position = vec4(mix(uPlace.xy, uPlace.zw, corner), 0.0, 1.0);
}`;

  /**
   * Sums of planes at several directions, each behind the curve where there is one.
   *
   * A node has three weight vectors for each layer, then those of 1 everywhere, then shares of the channels. All are
   * uniforms of fixed places: without a graphics card, whatever is looked up is slow.
   */
  const planeSum = (layers, nodes, bent) => `#version 300 es
precision highp float;
precision highp sampler2DArray;
uniform sampler2DArray uPlanes;
uniform vec4 uWeights[${nodes * (3 * layers + 2)}];
uniform float uLayer;
uniform float uAlpha;
in vec2 vTexture;
out vec4 radiance;
// The sRGB curve. Without a graphics card a power takes longer than all sums: r^0.8 to 3e-4 of its value, r up to 2.5.
vec3 unbent(vec3 v) {
  vec3 size = abs(v);
  vec3 t = (size + 0.055) / 1.055;
  vec3 r = min(sqrt(t), 2.5);
  vec3 slow = 0.0493294 + r * (1.2228164 + r * (-0.4480073 + r * (0.2395466 + r * (-0.0729535 + r * 0.0090367))));
  vec3 power = t * t * slow;
  return sign(v) * mix(power, size / 12.92, lessThanEqual(size, vec3(0.04045)));
}
void main() {
  ${listed(layers, (i) => `vec4 p${i} = texture(uPlanes, vec3(vTexture, uLayer + ${i}.0));`)}
  vec3 total = vec3(0.0);
  vec3 sum;
  ${listed(nodes, (n) => nodeText(layers, n * (3 * layers + 2), bent))}
  radiance = vec4(total, uAlpha);
}`;

  const listed = (count, text) => Array.from({ length: count }, (_, i) => text(i)).join("\n  ");
  const nodeText = (layers, at, bent) => `sum = uWeights[${at + 3 * layers}].rgb;
  ${listed(layers, (i) => `sum += vec3(${[0, 1, 2].map((c) => `dot(p${i}, uWeights[${at + 3 * i + c}])`).join(", ")});`)}
  total += uWeights[${at + 3 * layers + 1}].rgb * ${bent ? "unbent(sum)" : "sum"};`;

  // Each way to compare and each curve is a program of its own: without a graphics card, every step counts.
  const CURVES = { linear: "clamp(v, 0.0, 1.0)", srgb: "encode(v)", filmic: "encode(film(v))" };
  const WAYS = {
    one: "shown = vec4(mix(GROUND, curved(first.rgb), first.a), 1.0);",
    split: `vec4 chosen = gl_FragCoord.x > uSplit * uWidth ? texelFetch(uSecond, at, 0) : first;
  shown = vec4(mix(GROUND, curved(chosen.rgb), chosen.a), 1.0);`,
    error: `vec4 second = texelFetch(uSecond, at, 0);
  vec3 apart = abs(curved(first.rgb) - curved(second.rgb));
  vec3 colour = heat(uErrorGain * max(apart.r, max(apart.g, apart.b)));
  shown = vec4(mix(GROUND, colour, min(first.a, second.a)), 1.0);`,
  };

  /** Pictures of the screen's size onto it. */
  const show = (compare, curve) => `#version 300 es
precision highp float;
uniform sampler2D uFirst;
uniform sampler2D uSecond;
uniform float uGain;       // 2 to the stops
uniform float uErrorGain;
uniform float uSplit;      // 0 to 1
uniform float uWidth;
in vec2 vTexture;
out vec4 shown;
const vec3 GROUND = vec3(0.055, 0.059, 0.067);
vec3 encode(vec3 v) {
  v = clamp(v, 0.0, 1.0);
  return mix(1.055 * pow(v, vec3(1.0 / 2.4)) - 0.055, 12.92 * v, lessThanEqual(v, vec3(0.0031308)));
}
// The fit of K. Narkowicz (2015) to the curve of the Academy Color Encoding System.
vec3 film(vec3 v) {
  v = max(v, 0.0);
  return v * (2.51 * v + 0.03) / (v * (2.43 * v + 0.59) + 0.14);
}
vec3 curved(vec3 v) {
  v *= uGain;
  return ${CURVES[curve]};
}
// Dark to light over violet, red and yellow.
vec3 heat(float t) {
  t = clamp(t, 0.0, 1.0);
  return clamp(vec3(1.9 * t, 2.4 * t * t - 0.35 * t, 0.55 * sin(5.2 * t) * (1.0 - t) + pow(t, 6.0)), 0.0, 1.0);
}
void main() {
  ivec2 at = ivec2(gl_FragCoord.xy);
  vec4 first = texelFetch(uFirst, at, 0);
  ${WAYS[compare]}
}`;

  function compile(gl, vertex, fragment) {
    const program = gl.createProgram();
    for (const [kind, text] of [[gl.VERTEX_SHADER, vertex], [gl.FRAGMENT_SHADER, fragment]]) {
      const shader = gl.createShader(kind);
      gl.shaderSource(shader, text);
      gl.compileShader(shader);
      gl.attachShader(program, shader);
    }
    gl.linkProgram(program);
    if (!gl.getProgramParameter(program, gl.LINK_STATUS) && !gl.isContextLost()) {
      throw new Error(`a shader does not build: ${gl.getProgramInfoLog(program)}`);
    }
    const uniforms = {};
    for (let i = 0; i < gl.getProgramParameter(program, gl.ACTIVE_UNIFORMS); i++) {
      const name = gl.getActiveUniform(program, i).name.replace("[0]", "");
      uniforms[name] = gl.getUniformLocation(program, name);
    }
    return { program, uniforms };
  }

  Object.assign(clrelight, { compile, VERTEX, show, planeSum });
})();
