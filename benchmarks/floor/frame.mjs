// The frame of relax.c in plain JavaScript, as in a browser demo: one spring after the other.
//
//   node frame.mjs ROWS COLUMNS SUBSTEPS ITERATIONS FRAMES [dump]
//
// Cloth, wind and ball are those of relax.c. The springs have the order of the demos: particle by particle, row by row,
// each with its springs right, down, down-right, down-left, two right and two down. Every spring depends on the one
// before, so arrays of numbers and objects with x, y and z take the same time.

const FRAME_SECONDS = 1 / 60;
const WIDTH = 4.35; // [m]
const TOP = 3.975; // [m]
const AREA_DENSITY = 0.2; // [kg/m²]
const GRAVITY = 9.81; // [m/s²]
const DAMPING = 1.5; // [1/s]
const WIND = [0.4, 0, 0.9]; // [m/s]
const AIR_DENSITY = 1.225; // [kg/m³]
const DRAG = 1;
const LIFT = 1;
const BALL_REACH = 0.75; // [m] radius and margin

const DIRECTIONS = [
  { down: 0, right: 1, stiffness: 1 },
  { down: 1, right: 0, stiffness: 1 },
  { down: 1, right: 1, stiffness: 1 },
  { down: 1, right: -1, stiffness: 1 },
  { down: 0, right: 2, stiffness: 0.05 },
  { down: 2, right: 0, stiffness: 0.05 },
];

function stop(status, message) {
  console.error(message);
  process.exit(status);
}

function readArguments(words) {
  const dump = words.length === 6 && words[5] === "dump";
  if (words.length !== 5 && !dump) stop(2, "arguments: ROWS COLUMNS SUBSTEPS ITERATIONS FRAMES [dump]");
  const counts = words.slice(0, 5).map(Number);
  if (!counts.every((count, i) => Number.isInteger(count) && count >= (i < 2 ? 2 : 1) && count <= 100000)) {
    stop(2, "ROWS and COLUMNS are whole numbers from 2, SUBSTEPS, ITERATIONS and FRAMES from 1, to 100000");
  }
  return [...counts, dump];
}

function hang(rows, columns) {
  const count = rows * columns;
  const cloth = { rows, columns, side: WIDTH / (columns - 1), count };
  for (const name of ["x", "y", "z", "xBefore", "yBefore", "zBefore", "forceX", "forceY", "forceZ", "inverseMass"]) {
    cloth[name] = new Float64Array(count);
  }
  const first = [], second = [], rest = [], stiffness = [], triangles = [];
  for (let row = 0; row < rows; row++) {
    for (let column = 0; column < columns; column++) {
      const i = row * columns + column;
      cloth.x[i] = cloth.xBefore[i] = cloth.side * column - WIDTH / 2;
      cloth.y[i] = cloth.yBefore[i] = TOP - cloth.side * row;
      // A triangle gives a third of its mass to each corner; the top row is held.
      const falling = (row + column) % 2 === 0;
      const cells = (row % (rows - 1) ? 2 : 1) * (column % (columns - 1) ? 2 : 1);
      const mass = ((falling ? 2 : 1) * cells * AREA_DENSITY * cloth.side ** 2) / 6;
      cloth.inverseMass[i] = row === 0 ? 0 : 1 / mass;
      for (const direction of DIRECTIONS) {
        const { down, right } = direction;
        if (row + down >= rows || column + right < 0 || column + right >= columns) continue;
        first.push(i);
        second.push(i + down * columns + right);
        rest.push(cloth.side * Math.hypot(down, right));
        stiffness.push(direction.stiffness);
      }
      if (row + 1 < rows && column + 1 < columns) {
        const a = i, b = i + 1, c = i + columns, d = i + columns + 1;
        triangles.push(...(falling ? [a, c, d, a, d, b] : [a, c, b, b, c, d]));
      }
    }
  }
  cloth.first = Int32Array.from(first);
  cloth.second = Int32Array.from(second);
  cloth.rest = Float64Array.from(rest);
  cloth.stiffness = Float64Array.from(stiffness);
  cloth.triangles = Int32Array.from(triangles);
  return cloth;
}

// Drag along the air and lift across it, a third of the triangle's force to each corner; the law is told in relax.c.
function gatherAir(cloth, h) {
  const { x, y, z, xBefore, yBefore, zBefore, forceX, forceY, forceZ, triangles } = cloth;
  forceX.fill(0);
  forceY.fill(0);
  forceZ.fill(0);
  for (let t = 0; t < triangles.length; t += 3) {
    const a = triangles[t], b = triangles[t + 1], c = triangles[t + 2];
    const px = x[b] - x[a], py = y[b] - y[a], pz = z[b] - z[a];
    const qx = x[c] - x[a], qy = y[c] - y[a], qz = z[c] - z[a];
    const nx = (py * qz - pz * qy) / 2, ny = (pz * qx - px * qz) / 2, nz = (px * qy - py * qx) / 2;
    const ux = WIND[0] - (x[a] + x[b] + x[c] - xBefore[a] - xBefore[b] - xBefore[c]) / (3 * h);
    const uy = WIND[1] - (y[a] + y[b] + y[c] - yBefore[a] - yBefore[b] - yBefore[c]) / (3 * h);
    const uz = WIND[2] - (z[a] + z[b] + z[c] - zBefore[a] - zBefore[b] - zBefore[c]) / (3 * h);
    const area = Math.sqrt(nx * nx + ny * ny + nz * nz), speed = Math.sqrt(ux * ux + uy * uy + uz * uz);
    if (area === 0 || speed === 0) continue;
    const d = nx * ux + ny * uy + nz * uz;
    const along = ((AIR_DENSITY / 6) * (DRAG - LIFT) * d * d) / (area * speed);
    const across = ((AIR_DENSITY / 6) * LIFT * d * speed) / area;
    for (let k = t; k < t + 3; k++) {
      const corner = triangles[k];
      forceX[corner] += along * ux + across * nx;
      forceY[corner] += along * uy + across * ny;
      forceZ[corner] += along * uz + across * nz;
    }
  }
}

function verletStep(cloth, h) {
  const { count, x, y, z, xBefore, yBefore, zBefore, forceX, forceY, forceZ, inverseMass } = cloth;
  const kept = Math.exp(-DAMPING * h);
  gatherAir(cloth, h);
  for (let i = 0; i < count; i++) {
    const w = inverseMass[i], nowX = x[i], nowY = y[i], nowZ = z[i];
    if (w > 0) {
      x[i] += (nowX - xBefore[i]) * kept + forceX[i] * w * h * h;
      y[i] += (nowY - yBefore[i]) * kept + (forceY[i] * w - GRAVITY) * h * h;
      z[i] += (nowZ - zBefore[i]) * kept + forceZ[i] * w * h * h;
    }
    xBefore[i] = nowX;
    yBefore[i] = nowY;
    zBefore[i] = nowZ;
  }
}

function relaxSprings({ x, y, z, inverseMass, first, second, rest, stiffness }) {
  for (let s = 0; s < rest.length; s++) {
    const i = first[s], j = second[s];
    const w = inverseMass[i] + inverseMass[j];
    if (w === 0) continue;
    const dx = x[j] - x[i], dy = y[j] - y[i], dz = z[j] - z[i];
    const length = Math.sqrt(dx * dx + dy * dy + dz * dz);
    const part = (stiffness[s] * (length - rest[s])) / (length * w);
    const p = part * inverseMass[i], q = part * inverseMass[j];
    x[i] += dx * p;
    y[i] += dy * p;
    z[i] += dz * p;
    x[j] -= dx * q;
    y[j] -= dy * q;
    z[j] -= dz * q;
  }
}

function pushOut({ count, x, y, z, inverseMass }, ballX, ballY, ballZ) {
  for (let i = 0; i < count; i++) {
    const dx = x[i] - ballX, dy = y[i] - ballY, dz = z[i] - ballZ;
    const square = dx * dx + dy * dy + dz * dz;
    if (inverseMass[i] > 0 && square < BALL_REACH * BALL_REACH) {
      const stretch = BALL_REACH / Math.sqrt(square);
      x[i] = ballX + dx * stretch;
      y[i] = ballY + dy * stretch;
      z[i] = ballZ + dz * stretch;
    }
  }
}

function advanceFrame(cloth, frame, substeps, iterations) {
  const h = FRAME_SECONDS / substeps;
  for (let i = 1; i <= substeps; i++) {
    const turns = 2 * Math.PI * (frame * FRAME_SECONDS + i * h);
    verletStep(cloth, h);
    for (let k = 0; k < iterations; k++) {
      relaxSprings(cloth);
      pushOut(cloth, 1.3 * Math.sin(turns / 11), 1.3 + 0.2 * Math.sin(turns / 7), 1.7 * Math.cos(turns / 6));
    }
  }
}

function largestStrain({ rows, columns, side, x, y, z }) {
  let largest = 0;
  for (let i = 0; i < rows * columns; i++) {
    const neighbours = [];
    if (i % columns < columns - 1) neighbours.push(i + 1);
    if (i < (rows - 1) * columns) neighbours.push(i + columns);
    for (const j of neighbours) {
      largest = Math.max(largest, Math.abs(Math.hypot(x[j] - x[i], y[j] - y[i], z[j] - z[i]) / side - 1));
    }
  }
  return largest;
}

const [rows, columns, substeps, iterations, frames, dump] = readArguments(process.argv.slice(2));
const cloth = hang(rows, columns);
const ms = [];
for (let frame = 0; frame < frames; frame++) {
  const start = performance.now();
  advanceFrame(cloth, frame, substeps, iterations);
  ms.push(performance.now() - start);
}
const height = cloth.y.reduce((sum, y) => sum + y, 0) / cloth.count;
if (!Number.isFinite(height)) stop(1, "the cloth blew up");
ms.sort((a, b) => a - b);
const line = {
  program: "frame",
  rows,
  columns,
  substeps,
  iterations,
  frames,
  median_ms: (ms[(frames - 1) >> 1] + ms[frames >> 1]) / 2,
  best_ms: ms[0],
  p95_ms: ms[Math.ceil(0.95 * frames) - 1],
  max_strain: largestStrain(cloth),
  mean_height: height,
};
if (dump) line.positions = Array.from(cloth.x, (x, i) => [x, cloth.y[i], cloth.z[i]]);
console.log(JSON.stringify(line));
