// The picture of a cloth and of what is around it, in WebGL 2. `head` is what Python tells of a scene: its camera, light
// and solids (`page/surroundings.py`), and how many vertices the cloth has (`page/sheet.py`).

const SHADOW = 512; // texels along a side of the shadow map
const STILL = new Float32Array([1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1]);

const minus = (a, b) => a.map((v, k) => v - b[k]);
const dot = (a, b) => a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
const within = (v, low, high) => Math.min(Math.max(v, low), high);
const columns = (rows) => [0, 1, 2, 3].flatMap((k) => rows.map((row) => row[k]));

// -- the camera: azimuth from +z to +x, elevation, distance -----------------------------------------------------------

const STEEPEST = (89 * Math.PI) / 180;

class Camera {
  constructor(told) {
    Object.assign(this, told); // eye, target [m], fov [degrees], wide
    this.middle = told.target;
    this.left = this.right = 0; // [heights of the picture] how wide panels stand at its sides
    this.reset();
  }

  reset() {
    this.target = this.middle;
    const [x, y, z] = minus(this.eye, this.target);
    this.first = Math.max(Math.hypot(x, y, z), 1e-6);
    this.far = this.first;
    this.azimuth = Math.atan2(x, z);
    this.elevation = within(Math.asin(y / this.first), -STEEPEST, STEEPEST);
  }

  /** By heights of the picture. */
  orbit(right, up) {
    this.azimuth -= Math.PI * right;
    this.elevation = within(this.elevation - Math.PI * up, -STEEPEST, STEEPEST);
  }

  zoom(factor) {
    this.far = within(this.far * factor, this.first / 20, this.first * 20);
  }

  /** Sideways, by heights of the picture as they are at the target. */
  pan(right, up) {
    const height = 2 * this.far * Math.tan((this.fov * Math.PI) / 360), [x, y] = this.axes();
    this.target = this.target.map((v, k) => v + height * (right * x[k] + up * y[k]));
  }

  /** Unit vectors to the right, up and back. */
  axes() {
    const ca = Math.cos(this.azimuth), sa = Math.sin(this.azimuth);
    const ce = Math.cos(this.elevation), se = Math.sin(this.elevation);
    return [[ca, 0, -sa], [-se * sa, ce, -se * ca], [ce * sa, se, ce * ca]];
  }

  /** From the target [m]; a picture with little room is taken from farther off. */
  distance(aspect) {
    return this.far * Math.max(1, this.wide / Math.max(aspect - this.left - this.right, 0.1));
  }

  /** How far right of the middle the target is shown [heights of the picture]: in the middle of what is free. */
  get shift() {
    return (this.left - this.right) / 2;
  }

  /** The eye, and the matrix to clip space by columns. */
  seen(aspect) {
    const [right, up, back] = this.axes(), distance = this.distance(aspect);
    const aside = 2 * this.shift * distance * Math.tan((this.fov * Math.PI) / 360);
    const eye = this.target.map((v, k) => v + distance * back[k] - aside * right[k]);
    const near = distance / 50, end = distance + 8 * this.first;
    const f = 1 / Math.tan((this.fov * Math.PI) / 360);
    const row = (axis, s) => [...axis.map((v) => s * v), -s * dot(axis, eye)];
    const w = row(back, -1), z = w.map((v) => (v * (end + near)) / (end - near));
    z[3] -= (2 * end * near) / (end - near);
    return [eye, columns([row(right, f / aspect), row(up, f), z, w])];
  }
}

/** To the shadow map's cube, as the lamp sees it. */
function lamplit({ across, upwards, toLamp, target, shadowSide }) {
  const row = (axis, s) => [...axis.map((v) => (s * v) / shadowSide), (-s * dot(axis, target)) / shadowSide];
  return columns([row(across, 1), row(upwards, 1), row(toLamp, -1), [0, 0, 0, 1]]);
}

/** Place and normal of every vertex of a cloth, from the places `x` of its particles; normals are means of the first
 *  `count` / 3 triangles by their area. */
function shaped(x, owner, corners, count, out) {
  const n = new Float32Array(x.length);
  for (let t = 0; t < count; t += 3) {
    const a = 3 * owner[corners[t]], b = 3 * owner[corners[t + 1]], c = 3 * owner[corners[t + 2]];
    const ux = x[b] - x[a], uy = x[b + 1] - x[a + 1], uz = x[b + 2] - x[a + 2];
    const vx = x[c] - x[a], vy = x[c + 1] - x[a + 1], vz = x[c + 2] - x[a + 2];
    const nx = uy * vz - uz * vy, ny = uz * vx - ux * vz, nz = ux * vy - uy * vx;
    n[a] += nx; n[a + 1] += ny; n[a + 2] += nz;
    n[b] += nx; n[b + 1] += ny; n[b + 2] += nz;
    n[c] += nx; n[c + 1] += ny; n[c + 2] += nz;
  }
  for (let v = 0, at = 0; v < owner.length; v++) {
    for (let k = 3 * owner[v], end = k + 3; k < end; k++, at++) {
      out[at] = x[k];
      out[at + 3] = n[k];
    }
    at += 3;
  }
}

// -- light: one soft lamp with its shadow, sky and floor around, a gleam (Blinn 1977); light goes through cloth --------

const VERTEX = `#version 300 es
layout(location = 0) in vec3 place;
layout(location = 1) in vec3 direction;
layout(location = 2) in vec3 tint;
uniform mat4 pose, camera;
out vec3 p, normal, albedo;
void main() {
  p = (pose * vec4(place, 1.0)).xyz;
  normal = mat3(pose) * direction;
  albedo = tint;
  gl_Position = camera * vec4(p, 1.0);
}`;
const NOTHING = `#version 300 es
precision mediump float;
void main() {}`;
const FRAGMENT = `#version 300 es
precision highp float;
precision highp sampler2DShadow;
in vec3 p, normal, albedo;
out vec4 colour;
uniform sampler2DShadow dark;
uniform mat4 lamplit;
uniform vec3 eye, toLamp, lamp, sky, bounce, rim, toRim, background, target, line;
uniform float gloss, contrast, through, gleam, texel, off, soft, shadowSide, reach, lined, spacing, lineWidth;
uniform int kind; // 0 floor, 1 solid, 2 cloth

float share(vec3 n) { // of the lamp's light that gets here
  vec3 q = 0.5 + 0.5 * (lamplit * vec4(p + off * texel * ((dot(n, toLamp) < 0.0 ? -n : n) + toLamp), 1.0)).xyz;
  if (any(greaterThan(abs(q - 0.5), vec3(0.48)))) return 1.0;
  float lit = 0.0, tap = 0.5 * soft * texel / shadowSide;
  for (int i = 0; i < 4; i++)
    for (int j = 0; j < 4; j++) lit += texture(dark, q + vec3(tap * (vec2(i, j) - 1.5), 0.0));
  return lit / 16.0;
}
void main() {
  vec3 n = normalize(normal + vec3(0.0, 1e-20, 0.0));
  if (kind == 2 && !gl_FrontFacing) n = -n;
  vec3 base = albedo;
  float away = length(p - target * vec3(1.0, 0.0, 1.0) - vec3(0.0, p.y, 0.0));
  if (kind == 0 && away < lined) {
    vec2 beside = abs(fract(p.xz / spacing + 0.5) - 0.5) * spacing, pixel = fwidth(p.xz);
    vec2 on = clamp((0.5 * lineWidth - beside) / pixel + 0.5, vec2(0.0), min(lineWidth / pixel, 1.0));
    base = mix(base, line, max(on.x, on.y));
  }
  float cosine = dot(n, toLamp), lit = share(n);
  float direct = max(cosine, 0.0) + (kind == 2 ? through * max(-cosine, 0.0) : 0.0);
  vec3 light = mix(bounce, sky, 0.5 + 0.5 * n.y) + lit * direct * lamp + max(dot(n, toRim), 0.0) * rim;
  vec3 halfway = normalize(normalize(eye - p) + toLamp);
  vec3 gleaming = gloss * pow(max(dot(n, halfway), 0.0), gleam) * lamp;
  vec3 bright = min(base * mix(vec3(0.95), light, contrast) + gleaming, 1.0);
  colour = vec4(kind == 0 ? mix(bright, background, smoothstep(0.2, 0.8, away / reach)) : bright, 1.0);
}`;

// -- the painter -------------------------------------------------------------------------------------------------------

/** Draws one scene at a time into a canvas: `show` it once, `form` it for every moment, `draw` it from any side.
 *
 *  A moment has the cloth's vertices (`form`, by `shaped`), the count of its corners that are left, the pose of each
 *  solid, and, where it is not the cloth's own, a colour for every vertex (`tint`). */
class Painter {
  constructor(canvas) {
    const gl = canvas.getContext("webgl2", { alpha: false, antialias: true });
    if (!gl) throw new Error("This page needs WebGL 2, which this browser does not offer.");
    this.gl = gl;
    this.made = []; // of the scene that is shown
    this.shade = this.linked(NOTHING);
    this.paint = this.linked(FRAGMENT);
    this.dark = gl.createTexture();
    gl.bindTexture(gl.TEXTURE_2D, this.dark);
    gl.texStorage2D(gl.TEXTURE_2D, 1, gl.DEPTH_COMPONENT24, SHADOW, SHADOW);
    gl.texParameteri(gl.TEXTURE_2D, gl.TEXTURE_MIN_FILTER, gl.LINEAR);
    gl.texParameteri(gl.TEXTURE_2D, gl.TEXTURE_MAG_FILTER, gl.LINEAR);
    gl.texParameteri(gl.TEXTURE_2D, gl.TEXTURE_COMPARE_MODE, gl.COMPARE_REF_TO_TEXTURE);
    this.shadow = gl.createFramebuffer();
    gl.bindFramebuffer(gl.FRAMEBUFFER, this.shadow);
    gl.framebufferTexture2D(gl.FRAMEBUFFER, gl.DEPTH_ATTACHMENT, gl.TEXTURE_2D, this.dark, 0);
    gl.enable(gl.DEPTH_TEST);
  }

  /** A scene with its solids' vertices and corners, and the cloth's corners and colours. */
  show(head, { solids, solidCorners, corners, tint }) {
    const { gl } = this;
    for (const [array, ...buffers] of this.made) {
      gl.deleteVertexArray(array);
      buffers.forEach((one) => gl.deleteBuffer(one));
    }
    this.made = [];
    this.head = head;
    const { light } = head, [x, , z] = light.target, r = light.reach;
    const square = [[-r, -r], [-r, r], [r, r], [r, -r]].flatMap(([u, v]) => [x + u, head.ground ?? 0, z + v, 0, 1, 0]);
    this.floor = this.mesh(new Float32Array(square), new Uint32Array([0, 1, 2, 0, 2, 3]));
    this.solids = this.mesh(solids, solidCorners);
    this.cloth = this.mesh(new Float32Array(6 * head.vertices), corners, tint);
    this.own = tint; // the cloth's own colours
    this.tinted = tint; // those it has
    gl.clearColor(...light.background, 1);
  }

  /** Other corners of the same cloth: some of it is gone. */
  weave(corners) {
    const { gl } = this;
    gl.bindVertexArray(this.cloth[0]);
    gl.bufferSubData(gl.ELEMENT_ARRAY_BUFFER, 0, corners);
  }

  /** The moment that is drawn from now on, and its shadow. */
  form(moment) {
    const { gl, cloth: [, vertices, , colours] } = this;
    this.moment = moment;
    gl.bindBuffer(gl.ARRAY_BUFFER, vertices);
    gl.bufferSubData(gl.ARRAY_BUFFER, 0, moment.form);
    const tint = moment.tint ?? this.own;
    if (tint !== this.own || this.tinted !== this.own) {
      gl.bindBuffer(gl.ARRAY_BUFFER, colours);
      gl.bufferSubData(gl.ARRAY_BUFFER, 0, tint);
      this.tinted = tint;
    }
    this.lamp = lamplit(this.head.light);
    this.begin(this.shadow, SHADOW, SHADOW, this.shade, { camera: this.lamp });
    this.things(this.shade);
  }

  /** The moment as a camera sees it. */
  draw(camera) {
    const { gl, head, paint } = this, { width, height } = gl.canvas;
    const [eye, matrix] = camera.seen(width / height);
    const lit = { ...head.light, eye, camera: matrix, lamplit: this.lamp, dark: 0, contrast: 1 };
    this.begin(null, width, height, paint, lit);
    if (head.ground !== null) {
      gl.bindVertexArray(this.floor[0]);
      paint.set({ kind: 0, gloss: 0, pose: STILL });
      gl.vertexAttrib3fv(2, head.floor);
      gl.drawElements(gl.TRIANGLES, 6, gl.UNSIGNED_INT, 0);
    }
    this.things(paint);
  }

  /** Solids and cloth. Colours that stand for numbers are not shaded away. */
  things({ set }) {
    const { gl, head, moment } = this;
    gl.bindVertexArray(this.solids[0]);
    head.solids.forEach((one, k) => {
      gl.vertexAttrib3fv(2, one.tint);
      for (const pose of moment.poses(k)) {
        set({ kind: 1, gloss: head.gloss, pose });
        gl.drawElements(gl.TRIANGLES, one.corners, gl.UNSIGNED_INT, 4 * one.first);
      }
    });
    gl.bindVertexArray(this.cloth[0]);
    set({ kind: 2, pose: STILL, ...(moment.tint ? { gloss: 0, contrast: head.read } : { gloss: head.sheen }) });
    gl.drawElements(gl.TRIANGLES, moment.count, gl.UNSIGNED_INT, 0);
  }

  begin(target, width, height, { program, set }, values) {
    const { gl } = this;
    gl.bindFramebuffer(gl.FRAMEBUFFER, target);
    gl.viewport(0, 0, width, height);
    gl.clear(gl.COLOR_BUFFER_BIT | gl.DEPTH_BUFFER_BIT);
    gl.useProgram(program);
    set(values);
  }

  linked(fragment) {
    const { gl } = this, program = gl.createProgram();
    for (const [kind, source] of [[gl.VERTEX_SHADER, VERTEX], [gl.FRAGMENT_SHADER, fragment]]) {
      const shader = gl.createShader(kind);
      gl.shaderSource(shader, source);
      gl.compileShader(shader);
      gl.attachShader(program, shader);
    }
    gl.linkProgram(program);
    if (!gl.getProgramParameter(program, gl.LINK_STATUS)) throw new Error(gl.getProgramInfoLog(program));
    const at = {};
    for (let k = 0; k < gl.getProgramParameter(program, gl.ACTIVE_UNIFORMS); k++) {
      const { name, type } = gl.getActiveUniform(program, k);
      const place = gl.getUniformLocation(program, name);
      at[name] = { [gl.FLOAT]: (v) => gl.uniform1f(place, v), [gl.FLOAT_VEC3]: (v) => gl.uniform3fv(place, v),
        [gl.FLOAT_MAT4]: (v) => gl.uniformMatrix4fv(place, false, v) }[type] ?? ((v) => gl.uniform1i(place, v));
    }
    return { program, set: (values) => Object.entries(values).forEach(([name, v]) => at[name]?.(v)) };
  }

  /** Buffers of vertices, corners and colours; without colours of their own, vertices take that which is set. */
  mesh(vertices, corners, tint) {
    const { gl } = this;
    const buffer = (target, data) => {
      const made = gl.createBuffer();
      gl.bindBuffer(target, made);
      gl.bufferData(target, data, tint ? gl.DYNAMIC_DRAW : gl.STATIC_DRAW);
      return made;
    };
    const array = gl.createVertexArray();
    gl.bindVertexArray(array);
    const colours = tint && buffer(gl.ARRAY_BUFFER, tint);
    if (tint) {
      gl.enableVertexAttribArray(2);
      gl.vertexAttribPointer(2, 3, gl.UNSIGNED_BYTE, true, 3, 0);
    }
    const places = buffer(gl.ARRAY_BUFFER, vertices);
    for (const k of [0, 1]) {
      gl.enableVertexAttribArray(k);
      gl.vertexAttribPointer(k, 3, gl.FLOAT, false, 24, 12 * k);
    }
    const made = [array, places, buffer(gl.ELEMENT_ARRAY_BUFFER, corners), ...(tint ? [colours] : [])];
    this.made.push(made);
    return made;
  }
}

// -- the canvas --------------------------------------------------------------------------------------------------------

/** Keeps a canvas as fine as the screen, and calls `show` at once when its size changes, which empties it. */
function fitted(canvas, show) {
  new ResizeObserver(() => {
    const fine = Math.min(devicePixelRatio, 2);
    canvas.width = Math.max(1, Math.round(canvas.clientWidth * fine));
    canvas.height = Math.max(1, Math.round(canvas.clientHeight * fine));
    show();
  }).observe(canvas);
  canvas.addEventListener("webglcontextlost", (event) => event.preventDefault());
  canvas.addEventListener("webglcontextrestored", () => location.reload());
}

/** By how much a turn of the wheel zooms. */
const wheelFactor = (event) => Math.exp(within(event.deltaY * (event.deltaMode ? 0.05 : 0.0015), -0.3, 0.3));

/** Says why there is no picture. */
function complain(error) {
  console.error(error);
  document.querySelector("canvas").insertAdjacentHTML("afterend", '<div class="message"></div>');
  document.querySelector(".message").textContent = error.message;
}
