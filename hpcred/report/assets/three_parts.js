export {
  BufferAttribute, BufferGeometry, DoubleSide, LineSegments, Mesh, OrthographicCamera, Points, Scene, ShaderMaterial,
  Vector3, WebGLRenderer,
} from "three";
export { OrbitControls } from "three/examples/jsm/controls/OrbitControls.js";
