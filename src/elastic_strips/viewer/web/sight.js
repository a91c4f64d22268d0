// What stands between the camera and the robot is drawn as through a grid, so that the robot is seen through it.
const sight = { esEye: { value: viewer.camera.position }, esRobot: { value: new T.Vector3() }, esRadius: { value: 0 } };  // [m]
const FADED = ["obstacles", "map", "sensed"], BEFORE = 1.2;  // [m] before the robot begins what is looked through
const BAYER = "mat4(0., 8., 2., 10., 12., 4., 14., 6., 3., 11., 1., 9., 15., 7., 13., 5.)";
function looked_through(material) {
  if (material.userData.sight || !(material.isMeshStandardMaterial || material.isMeshBasicMaterial)) return;
  material.userData.sight = true;
  material.onBeforeCompile = (shader) => {
    Object.assign(shader.uniforms, sight);
    shader.vertexShader = shader.vertexShader.replace("#include <common>", "#include <common>\nvarying vec3 esPlace;")
      .replace("#include <project_vertex>", `#include <project_vertex>
        vec4 esAt = vec4(transformed, 1.0);
        #ifdef USE_INSTANCING
          esAt = instanceMatrix * esAt;
        #endif
        esPlace = (modelMatrix * esAt).xyz;`);
    shader.fragmentShader = shader.fragmentShader.replace("#include <common>",
      "#include <common>\nvarying vec3 esPlace;\nuniform vec3 esEye;\nuniform vec3 esRobot;\nuniform float esRadius;")
      .replace("#include <clipping_planes_fragment>", `#include <clipping_planes_fragment>
        vec3 esLine = esRobot - esEye, esFrom = esPlace - esEye;
        float esFar = length(esLine), esAlong = dot(esFrom, esLine) / esFar;
        if (esRadius > 0.0 && esAlong < esFar - ${BEFORE.toFixed(1)}) {
          float esOff = length(esFrom - esAlong / esFar * esLine) / (esRadius * esAlong / esFar);
          ivec2 esCell = ivec2(mod(gl_FragCoord.xy, 4.0));
          if (mix(0.8, 0.0, smoothstep(0.8, 1.2, esOff)) > (${BAYER}[esCell.x][esCell.y] + 0.5) / 16.0) discard;
        }`);
  };
  material.customProgramCacheKey = () => "es-sight";
  material.needsUpdate = true;
}
let found = 0;  // [ms] when the robot was looked for
function find_robot() {
  const node = viewer.scene_tree.children.robot;
  if (!node || performance.now() < found + (FINE ? 0 : 100)) return;
  found = performance.now();
  const box = new T.Box3(), p = new T.Vector3();
  each_mesh(node, ["robot"], (object) => {
    if (!object.geometry) return;
    object.updateWorldMatrix(true, false);  // where it is in the picture that is about to be drawn
    if (!object.geometry.boundingSphere) object.geometry.computeBoundingSphere();
    const { center, radius } = object.geometry.boundingSphere;
    p.copy(center).applyMatrix4(object.matrixWorld);
    box.expandByPoint(p.clone().subScalar(0.6 * radius)).expandByPoint(p.addScalar(0.6 * radius));
  });
  if (box.isEmpty()) return;
  box.getCenter(sight.esRobot.value);
  sight.esRadius.value = Math.min(0.5 * box.getSize(p).length(), 1.2);
}
const added_before = added;
added = (path) => {
  added_before(path);
  const object = (viewer.scene_tree.find(path).children["<object>"] || { }).object;
  if (object && object.material && FADED.includes(path[0])) looked_through(object.material);
};

// Drawn coarsely while something moves, and sharp once all is at rest.
const REST = 350;  // [ms]
let coarse = null, resting_picture = null;  // the ratio of pixels of a picture that is one of many
const drawn = viewer.render;
viewer.render = () => {
  find_robot();
  if (coarse !== null) { viewer.renderer.setPixelRatio(coarse); coarse = null; }
  drawn();
  clearTimeout(resting_picture);
  if (plain > 1 && !FINE) resting_picture = setTimeout(() => {
    coarse = viewer.renderer.getPixelRatio();
    viewer.renderer.setPixelRatio(window.devicePixelRatio);
    draw();
  }, REST);
};
