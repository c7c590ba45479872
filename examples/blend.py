"""Bold or careful: one knob between obstacles that repel and obstacles that merely bound.

Run it with ``python examples/blend.py``; it writes its figure into ``out/blend``.
"""

from pathlib import Path

import resgrid as rg

HERE = Path(__file__).resolve().parent


def main(folder: Path = Path("out/blend")) -> dict[float, tuple[float, float]]:
    # Two circuits of one flat.  Dirichlet: obstacles are held at 1 V, the current leaves them at right angles, and the
    # robot keeps away.  Neumann: obstacles are open, the current slides along them, and the robot comes close to them.
    scene = rg.read_scene(HERE / "scenes" / "rooms.toml")
    space = rg.sample(scene)
    dirichlet = rg.field(rg.solve(rg.compile_space(space, boundary="dirichlet")))
    neumann = rg.field(rg.solve(rg.compile_space(space, boundary="neumann")))

    # k mixes them (Connolly & Grupen 1992).  A sum of harmonic functions is harmonic: every blend keeps the promises.
    start = scene.starts[0]  # in the world, as are all points that resgrid takes and gives
    paths = {}
    for k in (0.0, 0.5, 1.0):
        field = rg.blend(dirichlet, neumann, k)
        paths[k] = rg.streamline(field, start=start)
        rg.certify(paths[k])
        print(f"k = {k:g}: {paths[k].length:.2f} m long, {paths[k].clearance:.3f} m clear of obstacles")
    assert paths[1.0].clearance > paths[0.0].clearance

    axes = rg.draw(neumann)
    rg.draw(list(paths.values()), axes, k=list(paths))
    axes.set_title("Blends over the Neumann potential", fontsize=9)
    folder.mkdir(parents=True, exist_ok=True)
    print(f"the figure is {rg.save_figure(axes, folder / 'blend.png')}")
    return {k: (path.length, path.clearance) for k, path in paths.items()}


if __name__ == "__main__":
    main()
