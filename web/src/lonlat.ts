// Between offsets from the map's origin and WGS 84, by the server's polynomials (src/conetl/web/search.py).
import { api, type Projection } from "./api";

export type Pair = [number, number];

function polynomial(coefficients: [number[], number[]], degree: number, u: number, v: number): Pair {
  let [a, b, k] = [0, 0, 0];
  for (let i = 0; i <= degree; i++) {
    for (let j = 0; j <= degree - i; j++) {
      const term = u ** i * v ** j;
      a += (coefficients[0][k] ?? 0) * term;
      b += (coefficients[1][k] ?? 0) * term;
      k += 1;
    }
  }
  return [a, b];
}

/** Longitude and latitude of an offset; null beyond the square in which the polynomials hold. */
export function toDegrees(p: Projection, [x, y]: Pair): Pair | null {
  const [u, v] = [(x - p.centre_m[0]) / p.radius_m, (y - p.centre_m[1]) / p.radius_m];
  if (Math.abs(u) > 1 || Math.abs(v) > 1) return null;
  const [east, north] = polynomial(p.to_degrees, p.degree, u, v);
  return [wrap(p.lon_deg + east / p.unit_per_degree[0]), p.lat_deg + north / p.unit_per_degree[1]];
}

/** The inverse of toDegrees; outside of the square it is an extrapolation. */
export function toMetres(p: Projection, [lon, lat]: Pair): Pair {
  const [u, v] = polynomial(p.to_metres, p.degree, wrap(lon - p.lon_deg) * p.unit_per_degree[0], (lat - p.lat_deg) * p.unit_per_degree[1]);
  return [p.centre_m[0] + u * p.radius_m, p.centre_m[1] + v * p.radius_m];
}

const DIRECTIONS = ["east", "north-east", "north", "north-west", "west", "south-west", "south", "south-east"];

/** The nearest town, with distance and direction beyond 5 km; empty without one within 50 km. */
export function townAt(p: Projection, [x, y]: Pair): string {
  let [nearest, label, direction] = [50_000, "", ""];
  for (const town of p.towns) {
    const [dx, dy] = [x - town.xy_m[0], y - town.xy_m[1]];
    const away = Math.hypot(dx, dy);
    if (away >= nearest) continue;
    [nearest, label] = [away, town.label];
    direction = DIRECTIONS[(Math.round(Math.atan2(dy, dx) / (Math.PI / 4)) + 8) % 8] ?? "";
  }
  return nearest < 5_000 || !label ? label : `${Math.round(nearest / 1000)} km ${direction} of ${label}`;
}

const wrap = (lon: number) => ((((lon + 180) % 360) + 360) % 360) - 180;

/** The projection of a map around any place: far from the last one, another is requested. */
export function createProjection(changed: () => void) {
  let map = "";
  let current: Projection | null = null;
  let requested = "";
  return {
    open(name: string): void {
      map = name;
      current = null;
      requested = "";
    },
    /** The one that holds at an offset; null until it is there, or where the map's CRS has none. */
    at([x, y]: Pair): Projection | null {
      if (current && Math.max(Math.abs(x - current.centre_m[0]), Math.abs(y - current.centre_m[1])) <= current.radius_m / 2) return current;
      const centre = [x, y].map((v) => Math.round(v / 10_000) * 10_000) as Pair;
      const key = `${map} ${centre.join(" ")}`;
      if (map && key !== requested && centre.every((v) => Math.abs(v) <= 5e6)) {
        requested = key;
        void api.projection(map, centre).then(
          (found) => {
            if (key !== requested) return;
            current = found;
            changed();
          },
          () => undefined, // the coordinates of the map's CRS are shown alone
        );
      }
      return current && toDegrees(current, [x, y]) ? current : null;
    },
  };
}
export type Projector = ReturnType<typeof createProjection>;
