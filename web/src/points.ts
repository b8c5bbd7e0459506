// The point cloud: tiles with levels of detail, selected by the camera within a budget of points.
import {
  BufferAttribute, BufferGeometry, Box3, Color, Frustum, Group, InterleavedBuffer, InterleavedBufferAttribute, Matrix4, Points, ShaderMaterial, Vector3,
} from "three";
import type { BaseTile } from "./api";
import { createEyeDome } from "./eye_dome";
import type { Stage } from "./scene";
import type { SceneState } from "./scene_state";
import type { Colours } from "./theme";

/** Largest number of points of a frame. */
export const MAX_DRAWN = 1_000_000;
/** Points kept on the graphics card; beyond that, the least recently drawn tiles are dropped. */
const MAX_KEPT = 3_000_000;
/** A finer tile is drawn if the spacing of the coarser one would exceed this number of pixels. */
const SPACING_PX = 1.4;
const PARALLEL = 6;
const EARLY_POINTS = 60_000;
const REDRAW_EVERY_MS = 200;
const ROOT_M = 4096;
const GRID = 128;
const POINT_M = 0.05;

interface Tile {
  sha256: string;
  count: number;
  box: Box3;
  /** Spacing of the coarser level, which is visible without this tile. */
  coarser_m: number;
  origin: Vector3;
  scale: Vector3;
  points: Points | null;
  state: "absent" | "loading" | "there" | "failed";
  usedAt: number;
}

export function createPoints(stage: Stage, onTrouble: (error: unknown) => void) {
  const group = new Group();
  stage.scene.add(group);
  const material = pointMaterial();
  group.add(noPoints(material)); // compiles the shader while the points are loading
  const frustum = new Frustum();
  const matrix = new Matrix4();
  const nearest = new Vector3();
  let tiles: Tile[] = [];
  let fetchTile: (sha256: string) => Promise<ArrayBuffer> = () => Promise.reject(new Error("no map"));
  let visible = true;
  let loading = 0;
  let kept = 0;
  let frame = 0;
  let wanted: Tile[] = [];
  let generation = 0;
  let redrawTimer = 0;

  stage.beforeDraw(() => {
    group.visible = visible && tiles.length > 0;
    material.uniforms["ground"]!.value = stage.ground;
    if (!group.visible) {
      stage.canvas.dataset["points"] = "0";
      return;
    }
    frame += 1;
    choose(MAX_DRAWN * stage.quality.share);
    load();
  });
  const eyeDome = createEyeDome(stage, group); // its pictures are made of the chosen tiles

  function choose(budget: number): void {
    const { camera } = stage;
    frustum.setFromProjectionMatrix(matrix.multiplyMatrices(camera.projectionMatrix, camera.matrixWorldInverse));
    const candidates: [number, Tile][] = [];
    for (const tile of tiles) {
      if (tile.points) tile.points.visible = false;
      if (!frustum.intersectsBox(tile.box)) continue;
      const distance = Math.max(tile.box.clampPoint(camera.position, nearest).distanceTo(camera.position), 0.5);
      const spacing_px = tile.coarser_m * stage.pixelsAtDepth(distance);
      if (spacing_px > SPACING_PX) candidates.push([spacing_px, tile]);
    }
    candidates.sort((a, b) => b[0] - a[0]);
    let count = 0;
    let drawn = 0;
    wanted = [];
    for (const [, tile] of candidates) {
      if (count + tile.count > budget) break;
      count += tile.count;
      tile.usedAt = frame;
      if (tile.points) {
        tile.points.visible = true;
        drawn += tile.count;
      } else if (tile.state === "absent") wanted.push(tile);
    }
    stage.canvas.dataset["points"] = String(drawn);
  }

  function load(): void {
    while (loading < PARALLEL) {
      const tile = wanted.shift();
      if (!tile) break;
      if (tile.state !== "absent") continue;
      tile.state = "loading";
      loading += 1;
      void fetchOne(tile, generation);
    }
    stage.canvas.dataset["loading"] = String(loading + wanted.length);
  }

  async function fetchOne(tile: Tile, mine: number): Promise<void> {
    try {
      const data = await fetchTile(tile.sha256);
      if (mine !== generation) return;
      tile.points = makePoints(tile, new Uint8Array(data), material);
      tile.state = "there";
      kept += tile.count;
      group.add(tile.points);
      evict();
    } catch (error) {
      if (mine !== generation) return;
      tile.state = "failed";
      onTrouble(error);
    } finally {
      if (mine === generation) {
        loading -= 1;
        load();
        const delay = loading ? REDRAW_EVERY_MS : 0;
        if (!redrawTimer || !delay) {
          window.clearTimeout(redrawTimer);
          redrawTimer = window.setTimeout(() => {
            redrawTimer = 0;
            stage.draw();
          }, delay);
        }
      }
    }
  }

  function evict(): void {
    if (kept <= MAX_KEPT) return;
    const old = tiles.filter((t) => t.points && t.usedAt < frame).sort((a, b) => a.usedAt - b.usedAt);
    for (const tile of old) {
      if (kept <= MAX_KEPT) return;
      drop(tile);
    }
  }

  function drop(tile: Tile): void {
    if (!tile.points) return;
    group.remove(tile.points);
    tile.points.geometry.dispose();
    tile.points = null;
    tile.state = "absent";
    kept -= tile.count;
  }

  return {
    setTiles(next: BaseTile[], fetcher: (sha256: string) => Promise<ArrayBuffer>): void {
      generation += 1;
      loading = 0;
      wanted = [];
      tiles.forEach(drop);
      kept = 0;
      fetchTile = fetcher;
      const top = next.reduce((level, t) => Math.min(level, t.level), Infinity);
      tiles = next.map((t) => {
        const side = ROOT_M / 2 ** t.level;
        const [x, y, z] = t.origin_m;
        return {
          sha256: t.sha256, count: t.points, points: null, state: "absent", usedAt: 0,
          box: new Box3(new Vector3(x, y, z), new Vector3(x + side, y + side, t.high_m)),
          coarser_m: t.level === top ? Infinity : (2 * side) / GRID,
          origin: new Vector3(x, y, z), scale: new Vector3(...t.scale_m),
        };
      });
      // The coarse ones are part of every frame: they are requested before the camera is known.
      let count = 0;
      wanted = tiles.filter((t) => (count += t.count) <= EARLY_POINTS);
      load();
      stage.draw();
    },
    setVisible(on: boolean): void {
      visible = on;
      stage.draw();
    },
    setStyle({ dark, bright, heights }: Colours, { colouring, size, opacity, shading }: SceneState): void {
      eyeDome(shading);
      const u = material.uniforms;
      [dark, bright, ...heights].forEach((css, i) => (u[["dark", "bright", "low", "middle", "high"][i]!]!.value as Color).set(css));
      u["colouring"]!.value = ["intensity", "height", "one"].indexOf(colouring);
      u["size"]!.value = size;
      u["opacity"]!.value = opacity;
      material.transparent = opacity < 1;
      stage.draw();
    },
  };
}

function noPoints(material: ShaderMaterial): Points {
  const geometry = new BufferGeometry();
  for (const [name, size] of [["position", 3], ["shade", 1]] as const) geometry.setAttribute(name, new BufferAttribute(new Float32Array(size), size));
  const points = new Points(geometry, material);
  points.visible = false;
  return points;
}

/** Steps and shade of `encode_points` (src/conetl/readers/base_layers/point_tiles.py): planes of low and high bytes of zigzag differences. */
export function decodePoints(data: Uint8Array): Uint16Array {
  const count = Math.floor(data.length / 7);
  const out = new Uint16Array(count * 4);
  for (let axis = 0; axis < 3; axis++) {
    const [low, high] = [2 * axis * count, (2 * axis + 1) * count];
    let value = 0;
    for (let i = 0; i < count; i++) {
      const zigzag = (data[low + i] ?? 0) | ((data[high + i] ?? 0) << 8);
      value = (value + ((zigzag >> 1) ^ -(zigzag & 1))) & 0xffff;
      out[4 * i + axis] = value;
    }
  }
  for (let i = 0; i < count; i++) out[4 * i + 3] = data[6 * count + i] ?? 0;
  return out;
}

function makePoints(tile: Tile, data: Uint8Array, material: ShaderMaterial): Points {
  if (data.length !== 7 * tile.count) throw new Error(`A tile has ${data.length} bytes instead of ${7 * tile.count}.`);
  const buffer = new InterleavedBuffer(decodePoints(data), 4);
  const geometry = new BufferGeometry()
    .setAttribute("position", new InterleavedBufferAttribute(buffer, 3, 0))
    .setAttribute("shade", new InterleavedBufferAttribute(buffer, 1, 3));
  const points = new Points(geometry, material);
  points.frustumCulled = false;
  points.matrixAutoUpdate = false;
  points.matrix.makeScale(tile.scale.x, tile.scale.y, tile.scale.z).setPosition(tile.origin);
  points.matrixWorldNeedsUpdate = true;
  points.visible = false;
  return points;
}

const VERTEX = /* glsl */ `
attribute float shade;
uniform vec3 dark;
uniform vec3 bright;
uniform vec3 low;
uniform vec3 middle;
uniform vec3 high;
uniform float colouring;
uniform float ground;
uniform float perMetre;
uniform float least;
varying vec3 vTint;
void main() {
  vec4 seen = modelViewMatrix * vec4(position, 1.0);
  gl_Position = projectionMatrix * seen;
  // Half a metre farther in depth: LiDAR points of a cone do not hide the cone.
  vec4 farther = projectionMatrix * vec4(seen.xy, seen.z - 0.5, 1.0);
  gl_Position.z = farther.z / farther.w * gl_Position.w;
  gl_PointSize = clamp(perMetre / max(gl_Position.w, 0.01), least, 3.0 * least);
  if (colouring < 0.5) vTint = mix(dark, bright, shade / 255.0);
  else if (colouring > 1.5) vTint = mix(dark, bright, 0.4);
  else {
    float up = clamp(((modelMatrix * vec4(position, 1.0)).z - ground) / 6.0, 0.0, 1.0);
    vTint = up < 0.5 ? mix(low, middle, 2.0 * up) : mix(middle, high, 2.0 * up - 1.0);
  }
}`;
const FRAGMENT = /* glsl */ `
uniform float opacity;
varying vec3 vTint;
void main() {
  if (distance(gl_PointCoord, vec2(0.5)) > 0.5) discard;  // round, also from near
  gl_FragColor = vec4(vTint, opacity);
  #include <colorspace_fragment>
}`;

function pointMaterial(): ShaderMaterial {
  const material = new ShaderMaterial({
    vertexShader: VERTEX,
    fragmentShader: FRAGMENT,
    uniforms: {
      ...Object.fromEntries(["dark", "bright", "low", "middle", "high"].map((name) => [name, { value: new Color() }])),
      perMetre: { value: 1 }, least: { value: 1.5 }, size: { value: 1 }, opacity: { value: 1 }, colouring: { value: 0 }, ground: { value: 0 },
    },
  }); // prettier-ignore
  material.onBeforeRender = (renderer, _scene, camera) => {
    const ratio = renderer.getPixelRatio();
    const height = renderer.domElement.height;
    const size = material.uniforms["size"]!.value as number;
    const projection = camera.projectionMatrix.elements[5] ?? 1;
    material.uniforms["perMetre"]!.value = (POINT_M * size * height * projection) / 2;
    material.uniforms["least"]!.value = 1.4 * ratio * size;
    material.uniformsNeedUpdate = true;
  };
  return material;
}
