// Frame pairs and their images, fetched once and kept while they are near.
import { api, type Frame, type Side } from "./api";
import { messageOf } from "./dom";

const MOST = 120;

export interface LoadedImage {
  url: string | null;
  problem: string | null;
}

export function createFrameCache() {
  const frames = new Map<string, Promise<Frame>>();
  const images = new Map<string, Promise<LoadedImage>>();

  function keep<T>(cache: Map<string, Promise<T>>, key: string, load: () => Promise<T>, drop: (old: T) => void): Promise<T> {
    const known = cache.get(key);
    if (known) return known;
    const loaded = load();
    cache.set(key, loaded);
    loaded.catch(() => cache.delete(key));
    const oldest = cache.size > MOST ? cache.keys().next().value : undefined;
    if (oldest !== undefined) {
      cache.get(oldest)?.then(drop, () => undefined);
      cache.delete(oldest);
    }
    return loaded;
  }

  async function load(map: string, frame: Frame, side: Side, feature: string | null): Promise<LoadedImage> {
    if (frame[side].problem !== null) return { url: null, problem: frame[side].problem };
    try {
      const url = URL.createObjectURL(await api.image(map, frame.drive_uuid, frame.frame_index, side, feature));
      await Object.assign(new Image(), { src: url }).decode().catch(() => undefined);
      return { url, problem: null };
    } catch (error) {
      return { url: null, problem: messageOf(error) };
    }
  }

  return {
    frame: (map: string, drive: string, index: number) =>
      keep(frames, `${map} ${drive} ${index}`, () => api.frame(map, drive, index), () => undefined),
    /** The image, decoded, or the reason why there is none. */
    image: (map: string, frame: Frame, side: Side, feature: string | null) =>
      keep(images, `${map} ${frame.drive_uuid} ${frame.frame_index} ${side} ${feature ?? ""}`, () => load(map, frame, side, feature),
        ({ url }) => url && URL.revokeObjectURL(url)), // prettier-ignore
  };
}

export type FrameCache = ReturnType<typeof createFrameCache>;
