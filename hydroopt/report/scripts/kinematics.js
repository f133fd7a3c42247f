// Poses of all bodies from the joints that move by themselves; poses are rows of [R | p], twelve numbers.
const machine = page.scene && (() => {
  const scene = page.scene, base = scene.base;
  const root = [...base.slice(0, 3), 0, ...base.slice(3, 6), 0, ...base.slice(6, 9), 0];
  const times = (a, b) => {
    const c = new Array(12);
    for (let i = 0; i < 12; i += 4) {
      for (let k = 0; k < 4; k++) c[i + k] = a[i] * b[k] + a[i + 1] * b[4 + k] + a[i + 2] * b[8 + k] + (k === 3 ? a[i + 3] : 0);
    }
    return c;
  };
  const moved = (kind, at) => {
    if (kind === "prismatic") return [1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, at];
    const c = Math.cos(at), s = Math.sin(at);
    return [c, -s, 0, 0, s, c, 0, 0, 0, 0, 1, 0];
  };
  const free = scene.joints.length;
  const independent = free - (scene.columns - scene.tree);
  // the joints of the tree that loops determine follow the independent ones; joints of a calibrator come last
  const tree = (q) => {
    const all = new Array(scene.columns);
    closeLoops(q, all);
    for (let k = independent; k < free; k++) all[scene.tree + k - independent] = q[k];
    return all;
  };
  const poses = (q) => {
    const all = tree(q), found = { base: root };
    for (const body of scene.bodies) {
      const seat = times(found[body.parent], body.seat);
      found[body.name] = body.column === null ? seat : times(seat, moved(body.joint, all[body.column]));
    }
    return found;
  };
  const place = (poses, { body, at }) => {
    const m = poses[body];
    return [0, 4, 8].map((i) => m[i] * at[0] + m[i + 1] * at[1] + m[i + 2] * at[2] + m[i + 3]);
  };
  const replayed = scene.replayed.map(column);
  // between two samples joints move evenly; beside a gap the sample with numbers counts
  const jointsAt = (index) => {
    const low = Math.floor(index), high = Math.min(low + 1, clock.last), f = clock.steps ? 0 : index - low;
    return replayed.map((values) => {
      const [a, b] = [values[low], values[high]];
      return Number.isFinite(a) && Number.isFinite(b) ? a + f * (b - a) : Number.isFinite(a) ? a : b;
    });
  };
  const tip = { body: scene.tip.body, at: scene.tip.at };
  const tipPlaces = () => {
    const reach = new Float32Array(clock.last + 1).fill(NaN), height = new Float32Array(clock.last + 1).fill(NaN);
    for (let k = 0; k <= clock.last; k++) {
      const [x, y, z] = place(poses(jointsAt(k)), tip);
      reach[k] = Math.hypot(x, y); height[k] = z;
    }
    return [reach, height];
  };
  return { scene, tree, poses, place, jointsAt, tipPlaces, closed: (q) => tree(q).every(Number.isFinite) };
})();
