"""Draws docs/images/grasp.gif: a simulated grasp, its taxels, and the shape that a model names.

The model is trained on all other trials of the folder; the one that is drawn is new to it.
MuJoCo draws without a screen with MUJOCO_GL=osmesa (or egl).

Examples:
    tactile simulate --out shapes --objects shapes --num-objects 40 --trials 15 --spread wide \\
      --seconds 5 --preset ci --seed 0
    MUJOCO_GL=osmesa python docs/images/draw_grasp.py shapes docs/images/grasp.gif
"""

import argparse
from pathlib import Path

import matplotlib
import mujoco
import numpy as np
import torch
from PIL import Image, ImageDraw, ImageFont
from torch.nn.functional import cross_entropy

from torch_geometric_tactile.data import Recording, StaticData
from torch_geometric_tactile.datasets import AllegroUSkin
from torch_geometric_tactile.io import read_recording
from torch_geometric_tactile.nn import PosedTaxelNet
from torch_geometric_tactile.sensors import HandKinematics, allegro_uskin
from torch_geometric_tactile.sim import drawn_objects, grasp_mjcf
from torch_geometric_tactile.training import training_recipe
from torch_geometric_tactile.transforms import TaxelPose

LAYOUT, HAND = allegro_uskin(), HandKinematics.allegro()
POSE = TaxelPose(LAYOUT, HAND, tangent=True)
VIEW, PANEL, HEIGHT = 460, 280, 400
INK, PALE, BLUE, ORANGE = "#1f2933", "#8a97a6", "#0072B2", "#D55E00"
BACKGROUND = (247, 249, 251)
FULL_FORCE = 0.5  # newtons at which a taxel has the last colour
TOUCHED = 100.0  # counts of the strongest taxel from which on the model is asked


def trained(root: str, left_out: str) -> tuple[PosedTaxelNet, list[str], int]:
    """A model that names the shape, trained on the frames of all trials but one."""
    dataset = AllegroUSkin(
        root, "shape", None, phases=("squeeze", "lift", "hold"), stride=40, tare="hover"
    )
    keep = [i for i, t in enumerate(dataset.trial_names) if t != left_out]
    found = dataset.batch(range(len(dataset)))
    rows = torch.isin(found.trial, torch.tensor(keep))
    data = POSE(StaticData(x=found.x.float(), joint=found.joint))
    inputs = {name: data[name][rows] for name in ("x", "pos", "normal", "tangent")}
    y, recipe = found.shape[rows], training_recipe(int(rows.sum()))
    torch.manual_seed(0)
    model = PosedTaxelNet(LAYOUT, len(dataset.shape_names))
    optimizer = torch.optim.AdamW(
        model.parameters(), recipe.lr, weight_decay=recipe.weight_decay, fused=True
    )
    steps = len(y) // recipe.batch_size
    schedule = torch.optim.lr_scheduler.OneCycleLR(
        optimizer, recipe.lr, recipe.max_epochs * steps, cycle_momentum=False
    )
    for _ in range(recipe.max_epochs):
        for batch in torch.randperm(len(y)).split(recipe.batch_size)[:steps]:
            optimizer.zero_grad()
            out = model(**{name: value[batch] for name, value in inputs.items()})
            cross_entropy(out, y[batch], label_smoothing=recipe.label_smoothing).backward()
            optimizer.step()
            schedule.step()
    return model.eval(), dataset.shape_names, len(keep)


@torch.no_grad()
def probabilities(model: PosedTaxelNet, trial: Recording) -> np.ndarray:
    """Probabilities of the shapes in each frame, NaN before anything is touched."""
    hover = trial.privileged["phase"] == trial.meta["phase_names"].index("hover")
    x = torch.from_numpy(trial.tactile - trial.tactile[hover].mean(axis=0)).float()
    data = POSE(StaticData(x=x, joint=torch.from_numpy(trial.joint)))
    out = model(data.x, pos=data.pos, normal=data.normal, tangent=data.tangent).softmax(-1)
    touched = x[:, :, 2].amax(dim=1) > TOUCHED
    return torch.where(touched[:, None], out, torch.nan).numpy()


class Stage:
    """Draws the hand, the object and the taxels of a trial with MuJoCo."""

    def __init__(self, trial: Recording, azimuth: float, elevation: float) -> None:
        (item,) = (o for o in drawn_objects(40, seed=0) if o.name == trial.label)
        spec = mujoco.MjSpec.from_string(grasp_mjcf(LAYOUT, HAND, item))
        spec.visual.headlight.ambient = [0.5, 0.5, 0.5]
        spec.visual.headlight.diffuse = [0.5, 0.5, 0.5]
        spec.visual.global_.offwidth, spec.visual.global_.offheight = 2 * VIEW, 2 * HEIGHT
        sky = [part / 255 for part in BACKGROUND]
        spec.add_texture(
            name="sky",
            type=mujoco.mjtTexture.mjTEXTURE_SKYBOX,
            builtin=mujoco.mjtBuiltin.mjBUILTIN_GRADIENT,
            rgb1=sky,
            rgb2=sky,
            width=64,
            height=64,
        )
        self.model = spec.compile()
        self.data = mujoco.MjData(self.model)
        self.renderer = mujoco.Renderer(self.model, 2 * HEIGHT, 2 * VIEW)
        self.trial = trial
        self.taxels = [self.model.geom(f"taxel_{i}").id for i in range(LAYOUT.num_taxels)]
        self.camera = mujoco.MjvCamera()
        self.camera.azimuth, self.camera.elevation, self.camera.distance = azimuth, elevation, 0.40
        for i in range(self.model.ngeom):
            name = self.model.geom(i).name
            if name.startswith("bone"):
                self.model.geom_rgba[i] = (0.70, 0.74, 0.79, 0.45)
        self.model.geom_rgba[self.model.geom("table").id] = (1.0, 1.0, 1.0, 0.0)
        self.model.geom_rgba[self.model.geom("stand").id] = (0.55, 0.58, 0.62, 1.0)
        self.model.geom_rgba[self.model.geom("object").id] = (0.35, 0.62, 0.88, 0.28)
        self.model.light_castshadow[:] = 0
        self.map = matplotlib.colormaps["autumn_r"]

    def image(self, frame: int) -> Image.Image:
        """The picture of a frame."""
        model, data, hidden = self.model, self.data, self.trial.privileged
        palm, turn = hidden["palm_pose"][frame], np.zeros(9)
        mujoco.mju_quat2Mat(turn, palm[3:])
        values = {
            "gantry_x": palm[0],
            "gantry_y": palm[1],
            "gantry_z": palm[2],
            "gantry_yaw": np.arctan2(turn[5], turn[2]),  # the fingers' direction, seen from above
            **dict(zip(HAND.joint_names, self.trial.joint[frame], strict=True)),
        }
        for name, value in values.items():
            data.qpos[model.joint(name).qposadr[0]] = value
        start = model.joint("object").qposadr[0]
        data.qpos[start : start + 7] = hidden["object_pose"][frame]
        mujoco.mj_forward(model, data)
        force = hidden["force"][frame, :, 2].clip(0) / FULL_FORCE
        for taxel, strength in zip(self.taxels, force, strict=True):
            color = self.map(0.2 + 0.8 * min(1.0, float(strength) ** 0.5))
            model.geom_rgba[taxel] = color if strength > 0.02 else (0.36, 0.40, 0.46, 1.0)
            model.geom_size[taxel, 0] = 0.0042 if strength > 0.02 else 0.003
        self.camera.lookat[:] = (palm[0] + 0.012, palm[1], palm[2] - 0.055)
        self.renderer.update_scene(data, self.camera)
        pixels = self.renderer.render()
        return Image.fromarray(pixels).resize((VIEW, HEIGHT), Image.Resampling.LANCZOS)


def panel(trial: Recording, frame: int, names: list[str], found: np.ndarray) -> Image.Image:
    """What the skin feels and what the model says."""
    image = Image.new("RGB", (PANEL, HEIGHT), BACKGROUND)
    draw = ImageDraw.Draw(image)
    path = Path(matplotlib.get_data_path()) / "fonts" / "ttf"
    plain = ImageFont.truetype(str(path / "DejaVuSans.ttf"), 15)
    bold = ImageFont.truetype(str(path / "DejaVuSans-Bold.ttf"), 22)
    small = ImageFont.truetype(str(path / "DejaVuSans.ttf"), 12)
    force = trial.privileged["force"][frame, :, 2].clip(0)
    phase = trial.meta["phase_names"][int(trial.privileged["phase"][frame])]
    draw.text((10, 26), f"{trial.time[frame]:.1f} s  {phase}", PALE, plain)
    draw.text((10, 52), f"{int((force > 0.01).sum())} of 384 taxels touched", INK, plain)
    draw.text((10, 74), f"{force.sum():.1f} N on the skin", INK, plain)
    known = not np.isnan(found).any()
    best = int(found.argmax()) if known else -1
    draw.text(
        (10, 122), names[best] if known else "nothing touched yet", ORANGE if known else PALE, bold
    )
    for i, name in enumerate(names):
        y = 170 + 34 * i
        draw.text((10, y), name, INK if i == best else PALE, plain)
        draw.rectangle((98, y + 2, 258, y + 16), fill="#e4e9ee")
        if known:
            width = round(160 * float(found[i]))
            draw.rectangle((98, y + 2, 98 + width, y + 16), fill=ORANGE if i == best else BLUE)
    draw.text((10, 330), f"the object: a {trial.meta['shape']},", PALE, small)
    draw.text((10, 346), f"{1000 * trial.meta['width']:.0f} mm wide; simulated;", PALE, small)
    draw.text((10, 362), "the model never saw this grasp", PALE, small)
    return image


def main() -> None:
    """Writes the file that the command line names."""
    parser = argparse.ArgumentParser()
    parser.add_argument("root")
    parser.add_argument("out")
    parser.add_argument("--trial", default="cylinder_003_004")
    parser.add_argument("--frames", type=int, default=56)
    parser.add_argument("--azimuth", type=float, default=75.0)
    parser.add_argument("--elevation", type=float, default=-4.0)
    parser.add_argument("--stills", help="a folder for single frames, without training")
    args = parser.parse_args()
    (path,) = Path(args.root).rglob(f"{args.trial}.h5")
    trial = read_recording(path)
    frames = np.linspace(0.1 * trial.num_frames, trial.num_frames - 1, args.frames).astype(int)
    stage = Stage(trial, args.azimuth, args.elevation)
    if args.stills:
        names, found = (
            ["box", "cylinder", "ellipsoid", "sphere"],
            np.full((trial.num_frames, 4), np.nan),
        )
        frames = frames[:: max(1, len(frames) // 6)]
    else:
        model, names, number = trained(args.root, args.trial)
        found = probabilities(model, trial)
        print(f"trained on {number} trials; right in the last frame: {names[found[-1].argmax()]}")
    pictures = []
    for frame in frames:
        picture = Image.new("RGB", (VIEW + PANEL, HEIGHT), BACKGROUND)
        picture.paste(stage.image(frame), (0, 0))
        picture.paste(panel(trial, frame, names, found[frame]), (VIEW, 0))
        pictures.append(picture)
    if args.stills:
        for i, picture in enumerate(pictures):
            picture.save(Path(args.stills) / f"{i}.png")
        return
    some = np.concatenate([np.asarray(picture) for picture in pictures[::6]])
    palette = Image.fromarray(some).quantize(220)
    small = [picture.quantize(palette=palette, dither=Image.Dither.NONE) for picture in pictures]
    duration = [90] * (len(small) - 1) + [2500]
    small[0].save(
        args.out, save_all=True, append_images=small[1:], duration=duration, loop=0, optimize=True
    )


if __name__ == "__main__":
    main()
