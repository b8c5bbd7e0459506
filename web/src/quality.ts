// What a frame may cost: while the camera moves, as much as leaves time for the next one; at rest all points, and smooth edges.
import { Camera, Mesh, PlaneGeometry, ShaderMaterial, SRGBColorSpace, Vector2, WebGLRenderTarget, type WebGLRenderer } from "three";

/** Time for a frame while the camera moves. */
const MOVING_MS = 40;
const REST_AFTER_MS = 250;
/** Share of the points in the first frame that moves, and the least one. */
const [FIRST, LEAST] = [0.25, 0.02];
/** A movement that falls below this share goes on without smooth edges and light. */
const PLAIN = 0.6;

export function createQuality(renderer: WebGLRenderer, rested: () => void) {
  // A canvas that smooths edges does so in every frame: it is drawn from this picture instead. As for XR, its colours are those of the canvas.
  const smooth = Object.assign(new WebGLRenderTarget(1, 1, { samples: 4, colorSpace: SRGBColorSpace, internalFormat: "RGBA8" }), { isXRRenderTarget: true });
  const copy = new Mesh(new PlaneGeometry(2, 2), new ShaderMaterial({
    vertexShader: "varying vec2 vAt; void main() { vAt = uv; gl_Position = vec4(position.xy, 0.0, 1.0); }",
    fragmentShader: "uniform sampler2D picture; varying vec2 vAt; void main() { gl_FragColor = vec4(texture2D(picture, vAt).rgb, 1.0); }",
    uniforms: { picture: { value: smooth.texture } }, depthTest: false, depthWrite: false,
  })); // prettier-ignore
  copy.frustumCulled = false;
  const [camera, size] = [new Camera(), new Vector2()];
  let moving = false;
  /** Until frames turn out to be quick. */
  let plain = true;
  /** Share of the points that a moving frame has time for. */
  let share = FIRST;
  let lastAt = 0;
  let last_ms = 0;
  let timer = 0;
  let resting = 0;

  /** The time between two frames of one movement is the cost of a frame, even if another process draws it; a single long one may be chance. */
  function adapt(): void {
    const now = performance.now();
    const between_ms = now - lastAt;
    lastAt = now;
    if (!moving) return void (last_ms = 0);
    const cost_ms = Math.min(last_ms, between_ms);
    last_ms = between_ms;
    if (cost_ms > MOVING_MS * 1.2) share = Math.max(LEAST, share * Math.max(MOVING_MS / cost_ms, 0.2));
    else if (between_ms < MOVING_MS * 0.8) share = Math.min(1, share * 1.15);
    plain ||= share < PLAIN;
  }

  return {
    /** The camera moved. */
    moved(): void {
      if (!moving) plain = share < PLAIN; // a quick movement before lets the next one try again
      moving = true;
      window.clearTimeout(timer);
      window.cancelAnimationFrame(resting);
      timer = window.setTimeout(() => {
        // After a long frame, what moves the camera comes first.
        resting = window.requestAnimationFrame(() => {
          moving = false;
          rested();
        });
      }, REST_AFTER_MS);
    },
    /** To be called at the beginning of each frame. */
    adapt,
    /** Share of the points that are drawn, 0 to 1. */
    get share(): number {
      return moving ? share : 1;
    },
    /** Without what makes a picture nicer. */
    get plain(): boolean {
      return moving && plain;
    },
    /** Draw a frame by a function. */
    draw(render: () => void): void {
      if (moving && plain) return render();
      renderer.getDrawingBufferSize(size);
      smooth.setSize(size.x, size.y);
      renderer.setRenderTarget(smooth);
      render();
      renderer.setRenderTarget(null);
      renderer.render(copy, camera);
    },
  };
}
