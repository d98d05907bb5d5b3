// WebGL 2 renderer for the cloth and the solids around it. `head` is the description of a scene from `render/webgl.py`:
// camera, light, solids, and the number of vertices of the cloth.

const SHADOW_MAP_SIZE = 512; // [texels] side of the shadow map
const IDENTITY = new Float32Array([1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1]);

const subtract = (a, b) => a.map((v, k) => v - b[k]);
const dot = (a, b) => a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
const cross = (a, b) => [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]];
const clamp = (v, low, high) => Math.min(Math.max(v, low), high);
const columnMajor = (rows) => [0, 1, 2, 3].flatMap((k) => rows.map((row) => row[k]));

// -- orbit camera: azimuth from +z to +x, elevation, distance ---------------------------------------------------------

const MAX_ELEVATION = (89 * Math.PI) / 180;
const CLOTH_MARGIN = 1.03; // smallest distance of the eye in front of cloth; the near plane is at 1/50 of it
const FLOOR_CLEARANCE = 0.02; // smallest height of eye and target above the floor [initial distances]

class Camera {
  constructor(description) {
    Object.assign(this, description); // eye, target, floor or null [m], fov [degrees], minAspect
    this.initialTarget = description.target;
    this.leftPanel = this.rightPanel = 0; // [image heights] widths of the panels at the left and right side
    this.reset();
  }

  reset() {
    this.target = this.initialTarget;
    const [x, y, z] = subtract(this.eye, this.target);
    this.initialDistance = Math.max(Math.hypot(x, y, z), 1e-6);
    this.orbitDistance = this.initialDistance;
    this.azimuth = Math.atan2(x, z);
    this.elevation = clamp(Math.asin(y / this.initialDistance), -MAX_ELEVATION, MAX_ELEVATION);
  }

  /** Rotates about the target by a cursor motion [image heights]; 1 is half a turn. */
  orbit(right, up) {
    this.azimuth -= Math.PI * right;
    this.elevation = clamp(this.elevation - Math.PI * up, -MAX_ELEVATION, MAX_ELEVATION);
  }

  /** Multiplies the distance of the eye from the target by `factor`. The eye stays in front of a share `cloth` of it. */
  zoom(factor, cloth = 0) {
    const closest = clamp(CLOTH_MARGIN * cloth * this.orbitDistance, this.initialDistance / 20, this.orbitDistance);
    this.orbitDistance = clamp(this.orbitDistance * factor, closest, this.initialDistance * 20);
  }

  /** Moves eye and target parallel to the image [image heights at the distance of the target]. */
  pan(right, up) {
    const height = 2 * this.orbitDistance * Math.tan((this.fov * Math.PI) / 360), [x, y] = this.axes();
    this.target = this.target.map((v, k) => v + height * (right * x[k] + up * y[k]));
  }

  /** Raises the target, and turns the eye up, to what lies above the floor: from below it would hide the cloth. */
  stayAboveFloor(distance) {
    if (this.floor === null) return;
    const lowest = this.floor + FLOOR_CLEARANCE * this.initialDistance, [x, y, z] = this.target;
    this.target = [x, Math.max(y, lowest), z];
    this.elevation = Math.max(this.elevation, Math.asin(Math.max((lowest - this.target[1]) / distance, -1)));
  }

  /** Unit vectors right, up and back (from target to eye). */
  axes() {
    const ca = Math.cos(this.azimuth), sa = Math.sin(this.azimuth);
    const ce = Math.cos(this.elevation), se = Math.sin(this.elevation);
    return [[ca, 0, -sa], [-se * sa, ce, -se * ca], [ce * sa, se, ce * ca]];
  }

  /** Distance from eye to target [m]. It is larger if the free part of the image is narrow. */
  distance(aspect) {
    return this.orbitDistance * Math.max(1, this.minAspect / Math.max(aspect - this.leftPanel - this.rightPanel, 0.1));
  }

  /** Distance of the target to the right of the image center [image heights]: it is centered between the panels. */
  get viewShift() {
    return (this.leftPanel - this.rightPanel) / 2;
  }

  /** Returns the eye [m] and the matrix from world to clip space, column by column. */
  viewProjection(aspect) {
    const distance = this.distance(aspect);
    this.stayAboveFloor(distance);
    const [right, up, back] = this.axes();
    const sideways = 2 * this.viewShift * distance * Math.tan((this.fov * Math.PI) / 360);
    const eye = this.target.map((v, k) => v + distance * back[k] - sideways * right[k]);
    const near = distance / 50, far = distance + 8 * this.initialDistance;
    const f = 1 / Math.tan((this.fov * Math.PI) / 360);
    const row = (axis, s) => [...axis.map((v) => s * v), -s * dot(axis, eye)];
    const w = row(back, -1), z = w.map((v) => (v * (far + near)) / (far - near));
    z[3] -= (2 * far * near) / (far - near);
    return [eye, columnMajor([row(right, f / aspect), row(up, f), z, w])];
  }
}

/** Returns how far toward the eye the cloth reaches on the line from the target to it, as a share of the distance.
 *  `x` has the positions of its vertices, 6 numbers apart. Only the first `count` corners count. */
function clothInFront({ target, distance, back }, x, corners, count) {
  let nearest = 0; // to the eye [m]
  for (let t = 0; t < count; t += 3) {
    const [a, b, c] = [0, 1, 2].map((k) => subtract([...x.subarray(6 * corners[t + k], 6 * corners[t + k] + 3)], target));
    const u = dot(back, cross(b, c)), v = dot(back, cross(c, a)), w = dot(back, cross(a, b)), sum = u + v + w;
    const meets = Math.min(u, v, w) >= 0 || Math.max(u, v, w) <= 0; // the line meets the triangle
    if (sum !== 0 && meets) {
      const s = dot(a, cross(b, c)) / sum; // where [m from the target]
      if (s > nearest && s < distance) nearest = s;
    }
  }
  return nearest / distance;
}

/** Returns the matrix from world space to the clip space of the shadow map, column by column. */
function shadowMatrixOf({ shadowU, shadowV, lightDirection, target, shadowExtent }) {
  const row = (axis, s) => [...axis.map((v) => (s * v) / shadowExtent), (-s * dot(axis, target)) / shadowExtent];
  return columnMajor([row(shadowU, 1), row(shadowV, 1), row(lightDirection, -1), [0, 0, 0, 1]]);
}

/** Writes position and normal of every vertex of the cloth to `out`, from the particle positions `x`. Normals are
 *  area-weighted means over the first `count` / 3 triangles. */
function writeVertices(x, owner, corners, count, out) {
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

/** Returns the ends of the edges of all triangles. An edge of two triangles is listed twice, so that the edges of the
 *  first triangles come first. */
function edgesOf(corners) {
  const ends = new Uint32Array(2 * corners.length);
  for (let k = 0; k < corners.length; k++) {
    ends[2 * k] = corners[k];
    ends[2 * k + 1] = corners[k % 3 === 2 ? k - 2 : k + 1];
  }
  return ends;
}

// -- shaders: light with a soft shadow and a highlight (Blinn 1977), sky, floor and rim light; cloth transmits light --

const VERTEX_SHADER = `#version 300 es
layout(location = 0) in vec3 vertexPosition;
layout(location = 1) in vec3 vertexNormal;
layout(location = 2) in vec3 vertexColor;
uniform mat4 pose, camera;
out vec3 p, normal, albedo;
void main() {
  p = (pose * vec4(vertexPosition, 1.0)).xyz;
  normal = mat3(pose) * vertexNormal;
  albedo = vertexColor;
  gl_Position = camera * vec4(p, 1.0);
}`;
const DEPTH_FRAGMENT = `#version 300 es
precision mediump float;
void main() {}`;
const COLOR_FRAGMENT = `#version 300 es
precision highp float;
precision highp sampler2DShadow;
in vec3 p, normal, albedo;
out vec4 color;
uniform sampler2DShadow shadowMap;
uniform mat4 shadowMatrix;
uniform vec3 eye, lightDirection, lightColor, sky, floorLight, rimColor, rimDirection;
uniform vec3 background, target, gridLineColor;
uniform float gloss, contrast, transmission, specularExponent, texel, shadowBias, sampleSpacing, shadowExtent;
uniform float floorExtent, gridExtent, gridSpacing, gridLineWidth;
uniform int kind; // 0 floor, 1 solid, 2 cloth, 3 edges of the cloth

float litFraction(vec3 n) { // of the directional light that reaches p
  vec3 offset = shadowBias * texel * ((dot(n, lightDirection) < 0.0 ? -n : n) + lightDirection);
  vec3 q = 0.5 + 0.5 * (shadowMatrix * vec4(p + offset, 1.0)).xyz;
  if (any(greaterThan(abs(q - 0.5), vec3(0.48)))) return 1.0;
  float lit = 0.0, tap = 0.5 * sampleSpacing * texel / shadowExtent;
  for (int i = 0; i < 4; i++)
    for (int j = 0; j < 4; j++) lit += texture(shadowMap, q + vec3(tap * (vec2(i, j) - 1.5), 0.0));
  return lit / 16.0;
}
void main() {
  vec3 n = normalize(normal + vec3(0.0, 1e-20, 0.0));
  if (kind == 2 ? !gl_FrontFacing : kind == 3 && dot(n, eye - p) < 0.0) n = -n; // a line has no front
  vec3 base = albedo;
  float radius = length(p - target * vec3(1.0, 0.0, 1.0) - vec3(0.0, p.y, 0.0));
  if (kind == 0 && radius < gridExtent) {
    vec2 toLine = abs(fract(p.xz / gridSpacing + 0.5) - 0.5) * gridSpacing, pixel = fwidth(p.xz);
    vec2 coverage = clamp((0.5 * gridLineWidth - toLine) / pixel + 0.5, vec2(0.0), min(gridLineWidth / pixel, 1.0));
    base = mix(base, gridLineColor, max(coverage.x, coverage.y));
  }
  float cosine = dot(n, lightDirection), lit = litFraction(n);
  float direct = max(cosine, 0.0) + (kind >= 2 ? transmission * max(-cosine, 0.0) : 0.0);
  vec3 ambient = mix(floorLight, sky, 0.5 + 0.5 * n.y), rim = max(dot(n, rimDirection), 0.0) * rimColor;
  vec3 light = ambient + lit * direct * lightColor + rim;
  vec3 halfway = normalize(normalize(eye - p) + lightDirection);
  vec3 specular = gloss * pow(max(dot(n, halfway), 0.0), specularExponent) * lightColor;
  vec3 shaded = min(base * mix(vec3(0.95), light, contrast) + specular, 1.0);
  // Edges are darker than a light cloth and lighter than a dark one.
  if (kind == 3) shaded = mix(shaded, vec3(dot(albedo, vec3(0.3, 0.6, 0.1)) < 0.2 ? 1.0 : 0.0), 0.5);
  color = vec4(kind == 0 ? mix(shaded, background, smoothstep(0.2, 0.8, radius / floorExtent)) : shaded, 1.0);
}`;

// -- renderer ---------------------------------------------------------------------------------------------------------

/** Draws one scene at a time on a canvas. Call `loadScene` once per scene, `setFrame` once per frame, `draw` once per
 *  image.
 *
 *  A frame has the vertices of the cloth (`vertices`, from `writeVertices`), the number of corners that remain after
 *  tearing (`count`), a function that returns the poses of a solid by its index (`poses`), the vertices of the solids
 *  that deform (`solids`), and a color for every vertex (`colors`) if these are not the cloth's own colors. */
class Renderer {
  constructor(canvas) {
    const gl = canvas.getContext("webgl2", { alpha: false, antialias: true });
    if (!gl) throw new Error("This page needs WebGL 2, which this browser does not support.");
    this.gl = gl;
    this.meshes = []; // vertex arrays and buffers of the current scene
    this.showsEdges = false; // whether the edges of the cloth's triangles are drawn over it
    this.depthProgram = this.link(DEPTH_FRAGMENT);
    this.colorProgram = this.link(COLOR_FRAGMENT);
    this.shadowMap = gl.createTexture();
    gl.bindTexture(gl.TEXTURE_2D, this.shadowMap);
    gl.texStorage2D(gl.TEXTURE_2D, 1, gl.DEPTH_COMPONENT24, SHADOW_MAP_SIZE, SHADOW_MAP_SIZE);
    gl.texParameteri(gl.TEXTURE_2D, gl.TEXTURE_MIN_FILTER, gl.LINEAR);
    gl.texParameteri(gl.TEXTURE_2D, gl.TEXTURE_MAG_FILTER, gl.LINEAR);
    gl.texParameteri(gl.TEXTURE_2D, gl.TEXTURE_COMPARE_MODE, gl.COMPARE_REF_TO_TEXTURE);
    this.shadowFramebuffer = gl.createFramebuffer();
    gl.bindFramebuffer(gl.FRAMEBUFFER, this.shadowFramebuffer);
    gl.framebufferTexture2D(gl.FRAMEBUFFER, gl.DEPTH_ATTACHMENT, gl.TEXTURE_2D, this.shadowMap, 0);
    gl.enable(gl.DEPTH_TEST);
    gl.polygonOffset(1, 1);
  }

  /** Loads a scene: vertices and corners of the solids, corners and colors of the cloth. */
  loadScene(head, { solids, solidCorners, corners, colors }) {
    const { gl } = this;
    for (const [vertexArray, ...buffers] of this.meshes) {
      gl.deleteVertexArray(vertexArray);
      buffers.forEach((buffer) => gl.deleteBuffer(buffer));
    }
    this.meshes = [];
    this.head = head;
    this.light = head.light;
    const { light } = head, [x, , z] = light.target, r = light.floorExtent;
    const square = [[-r, -r], [-r, r], [r, r], [r, -r]].flatMap(([u, v]) => [x + u, head.ground ?? 0, z + v, 0, 1, 0]);
    this.floor = this.createMesh(new Float32Array(square), new Uint32Array([0, 1, 2, 0, 2, 3]));
    this.solids = this.createMesh(solids, solidCorners);
    this.cloth = this.createMesh(new Float32Array(6 * head.vertices), corners, colors);
    gl.bindVertexArray(null); // a vertex array would store the next buffer as that of its corners
    this.edges = this.createBuffer(gl.ELEMENT_ARRAY_BUFFER, edgesOf(corners), gl.DYNAMIC_DRAW);
    this.meshes.push([null, this.edges]);
    this.corners = corners; // of the cloth
    this.clothColors = colors; // the cloth's own colors
    this.uploadedColors = colors; // the colors in the buffer
    gl.clearColor(...light.background, 1);
  }

  /** Replaces the corners of the cloth after it has torn. */
  setCorners(corners) {
    const { gl } = this;
    this.corners = corners;
    gl.bindVertexArray(null);
    for (const [buffer, data] of [[this.cloth[2], corners], [this.edges, edgesOf(corners)]]) {
      gl.bindBuffer(gl.ELEMENT_ARRAY_BUFFER, buffer);
      gl.bufferSubData(gl.ELEMENT_ARRAY_BUFFER, 0, data);
    }
  }

  /** Moves floor and shadow map to a cloth that has left them, by multiples of the spacing of the grid lines. */
  followCloth(vertices) {
    const { light } = this.head, sum = [0, 0, 0]; // of the positions, relative to where the camera looks
    for (let i = 0; i < vertices.length; i += 6) light.target.forEach((v, k) => (sum[k] += vertices[i + k] - v));
    const offset = sum.map((v) => (6 * v) / vertices.length), away = subtract(this.light.target, light.target);
    if (!(Math.max(...subtract(offset, away).map(Math.abs)) > light.shadowExtent)) return;
    const moved = offset.map((v) => light.gridSpacing * Math.round(v / light.gridSpacing));
    this.light = { ...light, target: light.target.map((v, k) => v + moved[k]) };
  }

  /** Makes a frame the current one: uploads its vertices and colors, and renders its shadow map. */
  setFrame(frame) {
    const { gl, cloth: [, vertexBuffer, , colorBuffer] } = this;
    this.frame = frame;
    gl.bindBuffer(gl.ARRAY_BUFFER, vertexBuffer);
    gl.bufferSubData(gl.ARRAY_BUFFER, 0, frame.vertices);
    gl.bindBuffer(gl.ARRAY_BUFFER, this.solids[1]);
    let next = 0; // number of the next vertex in `frame.solids`
    for (const [first, count] of this.head.deforming) {
      gl.bufferSubData(gl.ARRAY_BUFFER, 24 * first, frame.solids.subarray(6 * next, 6 * (next + count)));
      next += count;
    }
    const colors = frame.colors ?? this.clothColors;
    if (colors !== this.clothColors || this.uploadedColors !== this.clothColors) {
      gl.bindBuffer(gl.ARRAY_BUFFER, colorBuffer);
      gl.bufferSubData(gl.ARRAY_BUFFER, 0, colors);
      this.uploadedColors = colors;
    }
    this.followCloth(frame.vertices);
    this.shadowMatrix = shadowMatrixOf(this.light);
    const values = { camera: this.shadowMatrix };
    this.beginPass(this.shadowFramebuffer, SHADOW_MAP_SIZE, SHADOW_MAP_SIZE, this.depthProgram, values);
    this.drawSolidsAndCloth(this.depthProgram);
  }

  /** Zooms a camera: by a factor below 1 the eye moves closer to the target, but not through cloth. */
  zoom(camera, factor) {
    const { frame, corners, gl: { canvas } } = this, distance = camera.distance(canvas.width / canvas.height);
    const line = { target: camera.target, distance, back: camera.axes()[2] };
    camera.zoom(factor, factor < 1 && frame ? clothInFront(line, frame.vertices, corners, frame.count) : 0);
  }

  /** Draws the current frame as a camera sees it. */
  draw(camera) {
    const { gl, head, colorProgram } = this, { width, height } = gl.canvas;
    const [eye, matrix] = camera.viewProjection(width / height);
    const values = { ...this.light, eye, camera: matrix, shadowMatrix: this.shadowMatrix, shadowMap: 0, contrast: 1 };
    this.beginPass(null, width, height, colorProgram, values);
    if (head.ground !== null) {
      gl.bindVertexArray(this.floor[0]);
      const [x, , z] = subtract(this.light.target, head.light.target);
      colorProgram.set({ kind: 0, gloss: 0, pose: new Float32Array([...IDENTITY.slice(0, 12), x, 0, z, 1]) });
      gl.vertexAttrib3fv(2, head.floor);
      gl.drawElements(gl.TRIANGLES, 6, gl.UNSIGNED_INT, 0);
    }
    if (this.showsEdges) gl.enable(gl.POLYGON_OFFSET_FILL); // the surface is drawn farther away than its edges
    this.drawSolidsAndCloth(colorProgram);
    gl.disable(gl.POLYGON_OFFSET_FILL);
    if (this.showsEdges) this.drawEdges(colorProgram);
  }

  /** Draws the edges of the cloth's triangles, with the uniforms that its surface was drawn with. */
  drawEdges({ set }) {
    const { gl, cloth: [vertexArray, , cornerBuffer] } = this;
    gl.bindVertexArray(vertexArray);
    gl.bindBuffer(gl.ELEMENT_ARRAY_BUFFER, this.edges);
    set({ kind: 3, gloss: 0 });
    gl.drawElements(gl.LINES, 2 * this.frame.count, gl.UNSIGNED_INT, 0);
    gl.bindBuffer(gl.ELEMENT_ARRAY_BUFFER, cornerBuffer);
  }

  /** Draws solids and cloth. Colors that stand for values get less contrast and no highlight, to stay readable. */
  drawSolidsAndCloth({ set }) {
    const { gl, head, frame } = this;
    gl.bindVertexArray(this.solids[0]);
    head.solids.forEach((solid, k) => {
      gl.vertexAttrib3fv(2, solid.color);
      for (const pose of frame.poses(k)) {
        set({ kind: 1, gloss: head.gloss, pose });
        gl.drawElements(gl.TRIANGLES, solid.corners, gl.UNSIGNED_INT, 4 * solid.first);
      }
    });
    gl.bindVertexArray(this.cloth[0]);
    const surface = frame.colors ? { gloss: 0, contrast: head.strainViewContrast } : { gloss: head.sheen };
    set({ kind: 2, pose: IDENTITY, ...surface });
    gl.drawElements(gl.TRIANGLES, frame.count, gl.UNSIGNED_INT, 0);
  }

  /** Clears a framebuffer (null: the canvas), and sets its program with the values of uniforms. */
  beginPass(framebuffer, width, height, { program, set }, values) {
    const { gl } = this;
    gl.bindFramebuffer(gl.FRAMEBUFFER, framebuffer);
    gl.viewport(0, 0, width, height);
    gl.clear(gl.COLOR_BUFFER_BIT | gl.DEPTH_BUFFER_BIT);
    gl.useProgram(program);
    set(values);
  }

  /** Compiles and links a program. Returns it with a function that sets uniforms by name and ignores unknown names. */
  link(fragmentShader) {
    const { gl } = this, program = gl.createProgram();
    for (const [kind, source] of [[gl.VERTEX_SHADER, VERTEX_SHADER], [gl.FRAGMENT_SHADER, fragmentShader]]) {
      const shader = gl.createShader(kind);
      gl.shaderSource(shader, source);
      gl.compileShader(shader);
      gl.attachShader(program, shader);
    }
    gl.linkProgram(program);
    if (!gl.getProgramParameter(program, gl.LINK_STATUS)) throw new Error(gl.getProgramInfoLog(program));
    const setters = {};
    for (let k = 0; k < gl.getProgramParameter(program, gl.ACTIVE_UNIFORMS); k++) {
      const { name, type } = gl.getActiveUniform(program, k);
      const location = gl.getUniformLocation(program, name);
      setters[name] = { [gl.FLOAT]: (v) => gl.uniform1f(location, v),
        [gl.FLOAT_VEC3]: (v) => gl.uniform3fv(location, v),
        [gl.FLOAT_MAT4]: (v) => gl.uniformMatrix4fv(location, false, v) }[type] ?? ((v) => gl.uniform1i(location, v));
    }
    return { program, set: (values) => Object.entries(values).forEach(([name, v]) => setters[name]?.(v)) };
  }

  /** Creates the buffers of a mesh. Without `colors`, its color is the current value of vertex attribute 2. */
  createMesh(vertices, corners, colors) {
    const { gl } = this, usage = colors ? gl.DYNAMIC_DRAW : gl.STATIC_DRAW;
    const vertexArray = gl.createVertexArray();
    gl.bindVertexArray(vertexArray);
    const colorBuffer = colors && this.createBuffer(gl.ARRAY_BUFFER, colors, usage);
    if (colors) {
      gl.enableVertexAttribArray(2);
      gl.vertexAttribPointer(2, 3, gl.UNSIGNED_BYTE, true, 3, 0);
    }
    const vertexBuffer = this.createBuffer(gl.ARRAY_BUFFER, vertices, usage);
    for (const k of [0, 1]) {
      gl.enableVertexAttribArray(k);
      gl.vertexAttribPointer(k, 3, gl.FLOAT, false, 24, 12 * k);
    }
    const cornerBuffer = this.createBuffer(gl.ELEMENT_ARRAY_BUFFER, corners, usage);
    const mesh = [vertexArray, vertexBuffer, cornerBuffer, ...(colors ? [colorBuffer] : [])];
    this.meshes.push(mesh);
    return mesh;
  }

  createBuffer(target, data, usage) {
    const { gl } = this, buffer = gl.createBuffer();
    gl.bindBuffer(target, buffer);
    gl.bufferData(target, data, usage);
    return buffer;
  }
}

// -- canvas -----------------------------------------------------------------------------------------------------------

/** Keeps the canvas at the resolution of the screen, up to 2 pixels per CSS pixel. Calls `draw` after each change of
 *  size, because that clears the canvas. */
function resizeCanvas(canvas, draw) {
  new ResizeObserver(() => {
    const pixelRatio = Math.min(devicePixelRatio, 2);
    canvas.width = Math.max(1, Math.round(canvas.clientWidth * pixelRatio));
    canvas.height = Math.max(1, Math.round(canvas.clientHeight * pixelRatio));
    draw();
  }).observe(canvas);
  canvas.addEventListener("webglcontextlost", (event) => event.preventDefault());
  canvas.addEventListener("webglcontextrestored", () => location.reload());
}

/** Returns the zoom factor of a wheel event. */
const wheelFactor = (event) => Math.exp(clamp(event.deltaY * (event.deltaMode ? 0.05 : 0.0015), -0.3, 0.3));

/** Shows an error message below the canvas. */
function showError(error) {
  console.error(error);
  document.querySelector("canvas").insertAdjacentHTML("afterend", '<div class="message"></div>');
  document.querySelector(".message").textContent = error.message;
}
