// Eye-dome lighting: LiDAR points are drawn into a picture of their own, and shaded where their neighbours in it are nearer (Boucheny 2009).
import { DepthTexture, HalfFloatType, Mesh, PlaneGeometry, Scene, ShaderMaterial, Vector2, Vector4, WebGLRenderTarget, type Group } from "three";
import type { Stage } from "./scene";

/** In pixels of the canvas, how far neighbours are. */
const REACH_PX = 1.4;
const STRENGTH = 18;

/** `points` are drawn by it while it is on, unless the camera moves and frames would take too long. */
export function createEyeDome(stage: Stage, points: Group) {
  const alone = new Scene();
  const target = new WebGLRenderTarget(1, 1, { type: HalfFloatType, depthTexture: new DepthTexture(1, 1) });
  const material = new ShaderMaterial({
    vertexShader: "varying vec2 vAt; void main() { vAt = uv; gl_Position = vec4(position.xy, 0.0, 1.0); }",
    fragmentShader: FRAGMENT,
    uniforms: { colours: { value: target.texture }, depths: { value: target.depthTexture }, reach: { value: new Vector2() }, range: { value: new Vector4() } },
  }); // prettier-ignore
  const picture = new Mesh(new PlaneGeometry(2, 2), material);
  picture.frustumCulled = false;
  picture.renderOrder = -2;
  picture.visible = false;
  stage.scene.add(picture);
  const size = new Vector2();
  let lit = false;

  stage.beforeDraw(() => {
    const into = lit && !stage.quality.plain ? alone : stage.scene;
    if (points.parent !== into) into.add(points);
    picture.visible = points.parent === alone && points.visible;
    if (!picture.visible) return;
    const { renderer, camera, plan } = stage;
    renderer.getDrawingBufferSize(size);
    target.setSize(size.x, size.y);
    (material.uniforms["reach"]!.value as Vector2).set(1, 1).divide(size).multiplyScalar(REACH_PX * renderer.getPixelRatio());
    (material.uniforms["range"]!.value as Vector4).set(camera.near, camera.far, plan ? 1 : 0, STRENGTH);
    renderer.setRenderTarget(target);
    renderer.clear();
    renderer.render(alone, camera);
    renderer.setRenderTarget(null);
  });

  return (on: boolean): void => void (lit = on);
}

const FRAGMENT = /* glsl */ `
uniform sampler2D colours;
uniform sampler2D depths;
uniform vec2 reach;
uniform vec4 range;  // near, far, whether it is a plan, strength
varying vec2 vAt;
float metres(float depth) {
  return range.z > 0.5 ? mix(range.x, range.y, depth) : range.x * range.y / (range.y - depth * (range.y - range.x));
}
float nearer(float here, vec2 by) {
  float there = texture2D(depths, vAt + by * reach).x;
  return there < 1.0 ? max(0.0, (here - metres(there)) / (range.z > 0.5 ? 60.0 : here)) : 0.0;
}
void main() {
  float depth = texture2D(depths, vAt).x;
  if (depth >= 1.0) discard;
  float here = metres(depth);
  float behind = nearer(here, vec2(1, 0)) + nearer(here, vec2(-1, 0)) + nearer(here, vec2(0, 1)) + nearer(here, vec2(0, -1));
  vec4 colour = texture2D(colours, vAt);
  gl_FragColor = vec4(colour.rgb * exp(-range.w * min(behind, 0.2)), colour.a);
  gl_FragDepth = depth;
  #include <colorspace_fragment>
}`;
