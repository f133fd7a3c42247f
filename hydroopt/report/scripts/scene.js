// The machine in space: links as hulls of what they join, cylinders with barrels and rods, drawn when something changes.
const view = machine && (() => {
  const holder = document.querySelector("[data-scene]"), canvas = holder.querySelector(".canvas"), scene = machine.scene;
  let renderer;
  try {
    renderer = new THREE.WebGLRenderer({ antialias: true, preserveDrawingBuffer: true });
  } catch {
    canvas.append(element("p", { class: "note" }, "This browser shows no 3-D graphics (WebGL)."));
    return null;
  }
  canvas.append(renderer.domElement);
  renderer.domElement.setAttribute("aria-hidden", "true");
  const world = new THREE.Scene(), camera = new THREE.PerspectiveCamera(32, 1, 0.05, 500);
  camera.up.set(0, 0, 1);
  const controls = new THREE.OrbitControls(camera, renderer.domElement);
  const sky = new THREE.HemisphereLight(0xffffff, 0x8899aa, 1.9), sun = new THREE.DirectionalLight(0xffffff, 1.6);
  world.add(sky, sun);
  let wanted = false;
  const render = () => {
    wanted = false;
    sun.position.copy(camera.position).add(new THREE.Vector3(0, 0, 6));
    renderer.render(world, camera);
  };
  const draw = () => {
    if (wanted) return;
    wanted = true;
    requestAnimationFrame(render);
  };
  controls.addEventListener("change", draw);

  // --- measures ---
  const middle = () => scene.joints.map((joint) => (joint.lower + joint.upper) / 2);
  const start = scene.replayed.length ? machine.jointsAt(0) : middle();
  const first = machine.poses(start);
  const reach = (body) => [...body.points, ...(body.section || [])];
  const corners = [...scene.bodies.flatMap((body) => reach(body).map((at) => machine.place(first, { body: body.name, at }))),
    ...scene.onBase.map((at) => machine.place(first, { body: "base", at })), ...scene.marks.filter((m) => m.kind !== "obstacle")
      .map((mark) => machine.place(first, mark)), [0, 0, 0]].filter((at) => at.every(Number.isFinite));
  const bounds = new THREE.Box3().setFromPoints(corners.map((at) => new THREE.Vector3(...at)));
  const size = Math.max(bounds.getSize(new THREE.Vector3()).length(), 0.1), thick = 0.013 * size;
  // without a stated ground the grid lies below all of the motion, or below the limits of every joint
  const some = scene.replayed.length ? [...Array(40).keys()].map((k) => machine.jointsAt(Math.round(k * clock.last / 39)))
    : scene.joints.flatMap((joint, k) => [joint.lower, joint.upper].map((limit) => start.map((at, j) => j === k ? limit : at)));
  const heights = some.filter(machine.closed).map(machine.poses).flatMap((poses) => scene.bodies.flatMap(
    (body) => reach(body).map((at) => machine.place(poses, { body: body.name, at })[2])));
  const lowest = Math.min(bounds.min.z, ...heights);

  // --- materials, whose colours follow the look of the page ---
  const materials = {};
  const material = (name, options = {}) => {
    materials[name] ||= new THREE.MeshStandardMaterial({ roughness: 0.62, metalness: 0.08, flatShading: false, ...options });
    return materials[name];
  };
  const lineMaterial = new THREE.LineBasicMaterial({ transparent: true, opacity: 0.45 });
  const pathMaterial = new THREE.LineBasicMaterial(), groundMaterial = new THREE.LineBasicMaterial({ transparent: true, opacity: 0.5 });
  const groups = {}, tinted = {};
  const placed = (name) => {
    if (!groups[name]) {
      groups[name] = new THREE.Group();
      groups[name].matrixAutoUpdate = false;
      world.add(groups[name]);
    }
    return groups[name];
  };

  // --- links: the hull of discs about the points that a link joins, across its joint's axis ---
  const ring = (at, radius, half) => [...Array(14).keys()].flatMap((k) => [-half, half].map((z) =>
    new THREE.Vector3(at[0] + radius * Math.cos(k * Math.PI / 7), at[1] + radius * Math.sin(k * Math.PI / 7), at[2] + z)));
  const hull = (name, points, own, half) => {
    const shape = new THREE.ConvexGeometry(points.flatMap((at) => ring(at, 1.5 * thick, half * thick)));
    const mesh = new THREE.Mesh(shape, own);
    mesh.add(new THREE.LineSegments(new THREE.EdgesGeometry(shape, 35), lineMaterial));
    placed(name).add(mesh);
    return mesh;
  };
  const pinShape = new THREE.CylinderGeometry(0.75 * thick, 0.75 * thick, 2.6 * thick, 20).rotateX(Math.PI / 2);
  // links in one plane differ in thickness and shade, so that each remains visible
  for (const [k, body] of scene.bodies.entries()) {
    const own = material("link").clone();
    tinted[body.name] = { material: own, plain: "link", shade: [1, 0.84, 1.14][k % 3] };
    for (const points of [body.points, body.section || []]) if (points.length) hull(body.name, points, own, 0.24 + 0.11 * (k % 3));
    placed(body.name).add(new THREE.Mesh(pinShape, material("pin")));
    if (body.com) {
      const ball = new THREE.Mesh(new THREE.SphereGeometry(0.8 * thick, 20, 14), material("com"));
      ball.position.set(...body.com);
      placed(body.name).add(ball);
    }
  }
  if (scene.onBase.length) hull("base", [[0, 0, 0], ...scene.onBase], material("chassis"), 0.5);
  for (const closing of scene.closings) {
    const pin = new THREE.Mesh(pinShape, material("pin"));
    pin.position.set(...closing.one.at);
    placed(closing.one.body).add(pin);
  }

  // --- struts: the barrel stands at one pin, the rod at the other, both along the line between them ---
  const tube = (radius, length, own) => new THREE.Mesh(new THREE.CylinderGeometry(radius, radius, length, 24)
    .rotateX(Math.PI / 2).translate(0, 0, length / 2), own);
  const struts = scene.struts.map((strut) => {
    const bore = Math.min(Math.max(strut.diameter * 1.25, 1.5 * thick), 3.2 * thick) / 2;
    const own = material(strut.kind).clone(), rodOnly = strut.kind === "rod" || strut.kind === "spring";
    tinted[strut.name] = { material: own, plain: strut.kind };
    const barrel = new THREE.Group(), rod = new THREE.Group(), ball = new THREE.SphereGeometry(0.8 * bore + 0.25 * thick, 20, 14);
    if (!rodOnly) barrel.add(tube(bore, strut.body, own));
    const piston = tube(rodOnly ? 0.5 * thick : 0.55 * bore, 1, rodOnly ? own : material("rod"));
    rod.add(piston);
    for (const end of [barrel, rod]) { end.add(new THREE.Mesh(ball, material("pin"))); world.add(end); }
    return { strut, barrel, rod, piston, rodOnly };
  });
  const along = (group, from, to) => {
    group.position.set(...from);
    group.quaternion.setFromUnitVectors(new THREE.Vector3(0, 0, 1), new THREE.Vector3(...to).sub(group.position).normalize());
  };

  // --- surroundings ---
  const floor = scene.ground ?? lowest - thick;
  const grid = new THREE.GridHelper(Math.ceil(1.6 * size), Math.ceil(1.6 * size)).rotateX(Math.PI / 2);
  grid.material = groundMaterial;
  const onFloor = new THREE.Group();
  onFloor.matrixAutoUpdate = false;
  const flat = new THREE.Matrix4().set(...scene.base.slice(0, 3), 0, ...scene.base.slice(3, 6), 0, ...scene.base.slice(6, 9), 0, 0, 0, 0, 1);
  onFloor.matrix.copy(scene.ground === null ? new THREE.Matrix4() : flat).multiply(new THREE.Matrix4().makeTranslation(0, 0, floor));
  onFloor.add(grid);
  const line = (points, own, parent = world) => {
    const made = new THREE.Line(new THREE.BufferGeometry().setFromPoints(points.map((at) => new THREE.Vector3(...at))), own);
    parent.add(made);
    return made;
  };
  if (scene.footprint.length) line([...scene.footprint, scene.footprint[0]].map(([x, y]) => [x, y, 0.01]), pathMaterial, onFloor);
  world.add(onFloor);
  const inBase = new THREE.Group();
  inBase.matrixAutoUpdate = false;
  inBase.matrix.copy(flat);
  world.add(inBase);
  if (scene.path) {
    const flatPath = unpack(scene.path);
    line(Array.from({ length: flatPath.length / 3 }, (_, k) => Array.from(flatPath.slice(3 * k, 3 * k + 3))), pathMaterial, inBase);
  }
  if (scene.workspace) {
    const [low, high] = scene.workspace, corner = (k) => [0, 1, 2].map((axis) => (k >> axis) & 1 ? high[axis] : low[axis]);
    for (const [a, b] of [[0, 1], [2, 3], [4, 5], [6, 7], [0, 2], [1, 3], [4, 6], [5, 7], [0, 4], [1, 5], [2, 6], [3, 7]]) line([corner(a), corner(b)], groundMaterial, inBase);
  }

  // --- names ---
  const labels = new THREE.Group();
  world.add(labels);
  const label = (text) => {
    const sheet = document.createElement("canvas"), pen = sheet.getContext("2d");
    const sprite = new THREE.Sprite(new THREE.SpriteMaterial({ depthTest: false, transparent: true, sizeAttenuation: false }));
    const write = () => {
      pen.font = "600 34px system-ui, sans-serif";
      sheet.width = pen.measureText(text).width + 20; sheet.height = 48;
      pen.font = "600 34px system-ui, sans-serif"; pen.lineJoin = "round"; pen.lineWidth = 9;
      pen.strokeStyle = look.colour("stage"); pen.strokeText(text, 10, 35);
      pen.fillStyle = look.colour("ink"); pen.fillText(text, 10, 35);
      sprite.material.map?.dispose();
      sprite.material.map = new THREE.CanvasTexture(sheet);
      sprite.material.map.colorSpace = "srgb";
    };
    write();
    look.listen(write);
    labels.add(sprite);
    return sprite;
  };
  for (const mark of scene.marks) {
    const own = material(mark.kind === "obstacle" ? "obstacle" : "mark", mark.kind === "obstacle" ? { transparent: true, opacity: 0.16, depthWrite: false } : {});
    const ball = new THREE.Mesh(new THREE.SphereGeometry(mark.kind === "obstacle" ? mark.radius : Math.max(mark.radius, 0.8 * thick), 28, 20), own);
    ball.position.set(...mark.at);
    placed(mark.body).add(ball);
  }
  const middleOf = (points) => [0, 1, 2].map((k) => points.reduce((sum, at) => sum + at[k], 0) / points.length);
  const named = [
    ...scene.bodies.map((body) => ({ sprite: label(body.name), at: (poses) => machine.place(poses, { body: body.name, at: middleOf(body.points) }) })),
    ...scene.struts.map((strut) => ({ sprite: label(strut.name), at: (poses) => middleOf([machine.place(poses, strut.start), machine.place(poses, strut.end)]) })),
    ...scene.marks.map((mark) => ({ sprite: label(mark.name), mark: true, at: (poses) => machine.place(poses, { ...mark, at: [mark.at[0], mark.at[1], mark.at[2] + (mark.kind === "obstacle" ? mark.radius : 2 * thick)] }) })),
  ];

  // names are as large on a phone as in a wide window
  const letters = () => {
    const high = 2 * Math.tan(camera.fov * Math.PI / 360) * 16 / canvas.clientHeight;
    for (const { sprite } of named) sprite.scale.set(sprite.material.map.image.width / sprite.material.map.image.height * high, high, 1);
  };

  // --- motion ---
  let poses = first, joints = start;
  const pose = (q) => {
    if (!machine.closed(q)) return false;
    joints = q;
    poses = machine.poses(q);
    for (const [name, group] of Object.entries(groups)) {
      const m = poses[name];
      group.matrix.set(...m.slice(0, 4), ...m.slice(4, 8), ...m.slice(8, 12), 0, 0, 0, 1);
      group.matrixWorldNeedsUpdate = true;
    }
    for (const { strut, barrel, rod, piston, rodOnly } of struts) {
      const [a, b] = [machine.place(poses, strut.start), machine.place(poses, strut.end)];
      along(barrel, a, b);
      along(rod, b, a);
      const length = Math.hypot(...a.map((x, k) => x - b[k]));
      piston.scale.z = rodOnly ? length : Math.max(length - 0.55 * strut.body, 0.1 * length);
    }
    for (const { sprite, at } of named) sprite.position.set(...at(poses));
    tint();
    draw();
    return true;
  };

  // --- colours ---
  let way = null;
  const select = holder.querySelector("[data-tint]"), legend = holder.querySelector("[data-legend]");
  const tint = () => {
    for (const [name, { material: own, plain, shade }] of Object.entries(tinted)) {
      let part;
      if (way) {
        const turned = Object.entries(scene.turning).filter(([, joint]) => joint === name).map(([drive]) => drive);
        const key = [name, ...turned].find((each) => each in way.columns || each in way.values);
        part = key === undefined ? undefined : key in way.columns ? Math.abs(column(way.columns[key][0])[clock.nearest]) / way.columns[key][1] : way.values[key];
      }
      if (Number.isFinite(part)) own.color.setRGB(...ramp(part / way.highest).map((c) => c / 255), "srgb");
      else own.color.setStyle(look.colour(way ? "faint" : plain)).multiplyScalar(shade ?? 1);
    }
  };
  const chosen = () => {
    way = scene.tints[+select.value] || null;
    legend.replaceChildren(...(way ? [element("span", {}, way.title), ...scale(way.unit, way.highest).childNodes] : []));
    tint();
    draw();
  };
  if (select && scene.tints.length) {
    select.append(...scene.tints.map((each, k) => element("option", { value: k }, each.name)), element("option", { value: -1 }, "parts"));
    select.closest("label").hidden = false;
    select.addEventListener("change", chosen);
  }

  // --- looking around ---
  const fit = () => {
    const centre = bounds.getCenter(new THREE.Vector3()), distance = 0.52 * size / Math.tan(camera.fov * Math.PI / 360) / Math.min(1, 0.72 * camera.aspect);
    camera.position.copy(centre).add(new THREE.Vector3(0.42, -1, 0.34).normalize().multiplyScalar(distance));
    controls.target.copy(centre);
    camera.near = distance / 100; camera.far = 20 * distance;
    camera.updateProjectionMatrix();
    controls.update();
    draw();
  };
  const turn = { ArrowLeft: [-0.1, 0, 1], ArrowRight: [0.1, 0, 1], ArrowUp: [0, -0.1, 1], ArrowDown: [0, 0.1, 1], "+": [0, 0, 0.9], "-": [0, 0, 1.1] };
  canvas.addEventListener("keydown", (event) => {
    if (!turn[event.key]) return;
    event.preventDefault();
    const [aside, up, nearer] = turn[event.key], from = camera.position.clone().sub(controls.target);
    const radius = from.length() * nearer, azimuth = Math.atan2(from.y, from.x) + aside;
    const polar = Math.min(Math.max(Math.acos(from.z / from.length()) + up, 0.05), 3.09);
    camera.position.copy(controls.target).add(new THREE.Vector3(Math.sin(polar) * Math.cos(azimuth), Math.sin(polar) * Math.sin(azimuth), Math.cos(polar)).multiplyScalar(radius));
    controls.update();
  });
  holder.querySelector("[data-reset]").addEventListener("click", fit);
  const names = holder.querySelector("[data-names]");
  // what stands around the machine is always named, its own parts if wanted
  const name = () => { for (const { sprite, mark } of named) sprite.visible = Boolean(mark) || names.checked; draw(); };
  names.addEventListener("change", name);
  name();

  const dress = () => {
    for (const [name, own] of Object.entries(materials)) own.color.setStyle(look.colour(name));
    lineMaterial.color.setStyle(look.colour("edge"));
    pathMaterial.color.setStyle(look.colour("predicted"));
    groundMaterial.color.setStyle(look.colour("line"));
    world.background = new THREE.Color(look.colour("stage"));
    tint();
    draw();
  };
  look.listen(dress);
  // printers get what the screen showed last of 3-D graphics, but a flat copy as it is: of the look of paper
  const paper = element("canvas", { class: "paper", "aria-hidden": "true" });
  canvas.after(paper);
  addEventListener("beforeprint", () => {
    render();
    [paper.width, paper.height] = [renderer.domElement.width, renderer.domElement.height];
    paper.getContext("2d").drawImage(renderer.domElement, 0, 0);
  });
  let sized = false;
  new ResizeObserver(() => {
    const { clientWidth: width, clientHeight: height } = canvas;
    if (!width || !height) return;
    renderer.setPixelRatio(Math.min(devicePixelRatio, 2));
    renderer.setSize(width, height);
    camera.aspect = width / height;
    camera.updateProjectionMatrix();
    letters();
    if (!sized) fit();
    sized = true;
    render();  // at once, since a new size empties the picture
  }).observe(canvas);

  // --- sliders where nothing is replayed ---
  if (scene.replayed.length) clock.listen((index) => pose(machine.jointsAt(index)));
  const panel = holder.querySelector("[data-joints]");
  for (const [k, joint] of scene.replayed.length || !panel ? [] : scene.joints.entries()) {
    const factor = joint.turns ? 180 / Math.PI : 1, unit = joint.turns ? "°" : "m";
    const range = element("input", { type: "range", min: joint.lower, max: joint.upper, step: "any", value: start[k], "data-joint": joint.name });
    const shown = element("output");
    const write = () => { shown.textContent = `${number(factor * +range.value)} ${unit}`; range.setAttribute("aria-valuetext", shown.textContent); };
    range.addEventListener("input", () => {
      const q = [...joints], open = element("span", { class: "bad" }, " cannot close");
      q[k] = +range.value;
      write();
      if (!pose(q)) shown.append(open);
    });
    write();
    panel.append(element("label", { class: "slider" }, element("span", {}, joint.name), range, shown));
  }
  if (select && scene.tints.length) chosen();
  dress();
  pose(start);

  const worldPoint = (object) => object.getWorldPosition(new THREE.Vector3()).toArray();
  return {
    pose, get joints() { return joints; },
    // positions [m] in the drawn scene: of each strut's ends and the pins of the bodies that hold them, and of loops' pins
    pins() {
      world.updateMatrixWorld(true);
      const of = ({ body, at }) => new THREE.Vector3(...at).applyMatrix4(placed(body).matrixWorld).toArray();
      const found = {};
      for (const { strut, barrel, rod } of struts) {
        found[`${strut.name}.barrel`] = [worldPoint(barrel), of(strut.start)];
        found[`${strut.name}.rod`] = [worldPoint(rod), of(strut.end)];
      }
      for (const closing of scene.closings) found[closing.name] = [of(closing.one), of(closing.other)];
      return found;
    },
  };
})();
