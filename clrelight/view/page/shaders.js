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

  /** Sum of planes times weights that are uniforms: one weight vector of each channel for each layer. */
  const linearSum = (layers) => `#version 300 es
precision highp float;
precision highp sampler2DArray;
uniform sampler2DArray uPlanes;
uniform vec4 uWeights[${3 * layers + 1}];
in vec2 vTexture;
out vec4 radiance;
void main() {
  vec3 sum = uWeights[${3 * layers}].rgb;
  ${Array.from({ length: layers }, (_, i) => `
  { vec4 p = texture(uPlanes, vec3(vTexture, ${i}.0));
    sum += vec3(dot(p, uWeights[${3 * i}]), dot(p, uWeights[${3 * i + 1}]), dot(p, uWeights[${3 * i + 2}])); }`).join("")}
  radiance = vec4(sum, 1.0);
}`;

  /** Sums at several directions, each behind the curve where there is one; weights are rows of a texture. */
  const nodeSum = (layers, bent) => `#version 300 es
precision highp float;
precision highp sampler2DArray;
uniform sampler2DArray uPlanes;
uniform sampler2D uTable;  // row: a node; three texels a layer, then those of 1 everywhere, then shares of channels
uniform int uNodes;
in vec2 vTexture;
out vec4 radiance;
vec3 unbent(vec3 v) {
  vec3 size = abs(v);
  vec3 power = pow((size + 0.055) / 1.055, vec3(2.4));
  return sign(v) * mix(power, size / 12.92, lessThanEqual(size, vec3(0.04045)));
}
void main() {
  vec4 p[${Math.max(layers, 1)}];
  for (int i = 0; i < ${layers}; i++) p[i] = texture(uPlanes, vec3(vTexture, float(i)));
  vec3 total = vec3(0.0);
  for (int n = 0; n < uNodes; n++) {
    vec3 sum = texelFetch(uTable, ivec2(${3 * layers}, n), 0).rgb;
    for (int i = 0; i < ${layers}; i++) {
      sum += vec3(dot(p[i], texelFetch(uTable, ivec2(3 * i, n), 0)), dot(p[i], texelFetch(uTable, ivec2(3 * i + 1, n), 0)),
        dot(p[i], texelFetch(uTable, ivec2(3 * i + 2, n), 0)));
    }
    total += texelFetch(uTable, ivec2(${3 * layers + 1}, n), 0).rgb * ${bent ? "unbent(sum)" : "sum"};
  }
  radiance = vec4(total, 1.0);
}`;

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

  Object.assign(clrelight, { compile, VERTEX, show, linearSum, nodeSum });
})();
