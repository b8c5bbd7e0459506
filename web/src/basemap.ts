// The base map of the operator's choice: Web Mercator tiles on the ground plane, bent into the map's CRS.
import { BufferAttribute, BufferGeometry, Group, Mesh, MeshBasicMaterial, SRGBColorSpace, Texture } from "three";
import type { BaseMapItem, Projection } from "./api";
import { el } from "./dom";
import { toDegrees, toMetres, type Pair, type Projector } from "./lonlat";
import type { Stage } from "./scene";

/** Pieces per side of a tile: their corners are where the map's CRS has them. */
const PIECES = 8;
const MAX_TILES = 64;
const MAX_KEPT = 256;
/** Seen at an angle, tiles farther than this many distances from the middle are left out. */
const FAR = 5;
/** Pixels of a tile's side below which a coarser zoom serves. */
const TILE_PX = 200;
const EQUATOR_M = 40_075_016.7;

interface Tile {
  mesh: Mesh<BufferGeometry, MeshBasicMaterial>;
  state: "loading" | "there" | "missing";
  zoom: number;
  usedAt: number;
}

/** Column and row of a place, with fractions, at a zoom. */
export function tileOf([lon, lat]: Pair, z: number): Pair {
  const [side, sin] = [2 ** z, Math.sin((lat * Math.PI) / 180)];
  return [((lon + 180) / 360) * side, (0.5 - Math.log((1 + sin) / (1 - sin)) / (4 * Math.PI)) * side];
}

/** The inverse of tileOf. */
export function placeOf([x, y]: Pair, z: number): Pair {
  const side = 2 ** z;
  return [(x / side) * 360 - 180, (Math.atan(Math.sinh(Math.PI * (1 - (2 * y) / side))) * 180) / Math.PI];
}

export function createBasemap(stage: Stage, host: HTMLElement, projector: Projector, trouble: (text: string) => void) {
  const group = new Group();
  stage.scene.add(group);
  const attribution = el("div", { class: "attribution", hidden: true });
  host.append(attribution);
  const tiles = new Map<string, Tile>();
  let item: BaseMapItem | null = null;
  let opacity = 1;
  let failed = 0;
  let frame = 0;

  stage.beforeDraw(() => {
    group.visible = item !== null && opacity > 0;
    if (!group.visible || !item) return;
    frame += 1;
    const { x, y } = { x: stage.pose()[0], y: stage.pose()[1] };
    const projection = projector.at([x, y]);
    if (projection) choose(item, projection);
  });

  function choose(from: BaseMapItem, projection: Projection): void {
    const seen = footprint(stage).map((p) => toDegrees(projection, p)).filter((p) => p !== null);
    const perMetre = stage.pixelsAtDepth(stage.pose()[5]);
    if (seen.length < 3) return;
    const round = EQUATOR_M * Math.cos((projection.lat_deg * Math.PI) / 180);
    let z = Math.min(Math.max(Math.floor(Math.log2((round * perMetre) / TILE_PX)), 0), from.max_zoom);
    let range = bounds(seen, z);
    while (z > 0 && (range.right - range.left + 1) * (range.bottom - range.top + 1) > MAX_TILES) range = bounds(seen, (z -= 1));
    let missing = 0;
    const shown = new Set<string>();
    for (let ty = range.top; ty <= range.bottom; ty++) {
      for (let tx = range.left; tx <= range.right; tx++) {
        const key = `${z}/${tx}/${ty}`;
        shown.add(key);
        const tile = tiles.get(key) ?? add(from, projection, key, z, tx, ty);
        tile.usedAt = frame;
        if (tile.state === "loading") missing += 1;
      }
    }
    // Until all are there, those of the last zoom stay under them.
    for (const [key, tile] of tiles) tile.mesh.visible = tile.state === "there" && (shown.has(key) || (missing > 0 && tile.usedAt > frame - 200));
    stage.canvas.dataset["tiles"] = String(shown.size - missing);
    evict();
  }

  function add(from: BaseMapItem, projection: Projection, key: string, z: number, x: number, y: number): Tile {
    const material = new MeshBasicMaterial({ transparent: opacity < 1, opacity, depthTest: false, depthWrite: false });
    const mesh = new Mesh(sheet(projection, z, x, y, stage.ground), material);
    mesh.frustumCulled = false;
    mesh.renderOrder = -100 + z; // under everything, finer tiles over coarser ones
    mesh.visible = false;
    const tile: Tile = { mesh, state: "loading", zoom: z, usedAt: frame };
    tiles.set(key, tile);
    group.add(mesh);
    const image = new Image();
    image.crossOrigin = "anonymous"; // the graphics card takes only images that their server allows to be read
    image.onload = () => {
      if (!group.children.includes(mesh)) return;
      const texture = new Texture(image);
      texture.colorSpace = SRGBColorSpace;
      texture.generateMipmaps = false;
      texture.minFilter = 1006; // linear
      texture.needsUpdate = true;
      material.map = texture;
      material.needsUpdate = true;
      tile.state = "there";
      stage.draw();
    };
    image.onerror = () => {
      tile.state = "missing";
      failed += 1;
      if (failed === 4 && ![...tiles.values()].some((t) => t.state === "there")) {
        trouble(`The base map cannot be loaded: ${new URL(image.src).host} does not answer, or does not allow other sites to use its tiles (CORS).`);
      }
      stage.draw();
    };
    image.src = from.template.replace("{z}", String(z)).replace("{x}", String(x)).replace("{y}", String(y)).replace("{-y}", String(2 ** z - 1 - y));
    return tile;
  }

  function evict(): void {
    if (tiles.size <= MAX_KEPT) return;
    const old = [...tiles].filter(([, t]) => t.usedAt < frame).sort((a, b) => a[1].usedAt - b[1].usedAt);
    for (const [key, tile] of old.slice(0, tiles.size - MAX_KEPT)) drop(key, tile);
  }

  function drop(key: string, { mesh }: Tile): void {
    group.remove(mesh);
    mesh.geometry.dispose();
    mesh.material.map?.dispose();
    mesh.material.dispose();
    tiles.delete(key);
  }

  function clear(): void {
    for (const [key, tile] of tiles) drop(key, tile);
  }

  return {
    open(next: BaseMapItem | null): void {
      clear();
      failed = 0;
      item = next;
      attribution.textContent = next?.attribution ?? "";
      stage.draw();
    },
    /** Tiles lie on the ground, which follows the cones. */
    clear,
    apply(next: number): void {
      opacity = next;
      for (const { mesh } of tiles.values()) {
        if (mesh.material.transparent !== opacity < 1) mesh.material.needsUpdate = true;
        mesh.material.transparent = opacity < 1;
        mesh.material.opacity = opacity;
      }
      attribution.hidden = !attribution.textContent || opacity === 0;
      stage.draw();
    },
  };
}

/** Corners and edges of what is seen of the ground, not beyond FAR distances from the middle. */
export function footprint(stage: Stage): Pair[] {
  const [x, y, , , , radius] = stage.pose();
  const { clientWidth: width, clientHeight: height } = stage.canvas;
  const seen: Pair[] = [];
  for (const [u, v] of [[0, 0], [0.5, 0], [1, 0], [1, 0.5], [1, 1], [0.5, 1], [0, 1], [0, 0.5]] as const) {
    // Above the horizon, the highest point of this column that shows near ground.
    for (let down = v; down <= 1; down += 0.125) {
      const at = stage.groundAt(u * width, down * height);
      if (!at || (!stage.plan && Math.hypot(at[0] - x, at[1] - y) > FAR * radius)) continue;
      seen.push([at[0], at[1]]);
      break;
    }
  }
  return seen;
}

function bounds(places: Pair[], z: number) {
  const most = 2 ** z - 1;
  const whole = (v: number) => Math.min(Math.max(Math.floor(v), 0), most);
  const at = places.map((p) => tileOf(p, z));
  const [columns, rows] = [at.map((p) => p[0]), at.map((p) => p[1])];
  return { left: whole(Math.min(...columns)), right: whole(Math.max(...columns)), top: whole(Math.min(...rows)), bottom: whole(Math.max(...rows)) };
}

/** The ground under a tile. */
function sheet(projection: Projection, z: number, x: number, y: number, ground: number): BufferGeometry {
  const [position, uv, index] = [[] as number[], [] as number[], [] as number[]];
  for (let row = 0; row <= PIECES; row++) {
    for (let column = 0; column <= PIECES; column++) {
      const [u, v] = [column / PIECES, row / PIECES];
      position.push(...toMetres(projection, placeOf([x + u, y + v], z)), ground);
      uv.push(u, 1 - v);
      const i = row * (PIECES + 1) + column;
      if (row < PIECES && column < PIECES) index.push(i, i + PIECES + 1, i + 1, i + 1, i + PIECES + 1, i + PIECES + 2);
    }
  }
  return new BufferGeometry()
    .setAttribute("position", new BufferAttribute(new Float32Array(position), 3))
    .setAttribute("uv", new BufferAttribute(new Float32Array(uv), 2))
    .setIndex(index);
}
