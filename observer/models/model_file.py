"""JSON file with the models of all joints, and the prediction of a recording with them."""

from __future__ import annotations

import hashlib
import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field, fields
from importlib.resources import files
from pathlib import Path
from typing import Any, Literal, NoReturn, Self

from pydantic.dataclasses import dataclass as validated_dataclass

from pepper_driver.config import ConfigError, PepperError, RobotConfig, RobotIdentity
from pepper_driver.config.arguments import as_path
from pepper_driver.config.arrays import FloatArray
from pepper_driver.config.errors import reason, short_reason
from pepper_driver.config.files import replacing
from pepper_driver.config.loading import STRICT, parse
from pepper_driver.config.parts import Positive
from pepper_driver.observer.models.fusion_model import BaseModel, FusionModel
from pepper_driver.observer.models.measured_robot import MeasuredRobot
from pepper_driver.observer.models.stick_slip import StickSlipModel
from pepper_driver.observer.models.tree import AffineTree, CartTree, Tree
from pepper_driver.observer.recording import Recording

FORMAT = 2

ModelKind = Literal["cart", "affine", "fusion"]

MODEL_TYPES: dict[ModelKind, type[JointModel]] = {
    "cart": CartTree,
    "affine": AffineTree,
    "fusion": FusionModel,
}

_REMEDY = "identify the robot with 'pepper identify'"
_SOURCE = "'pepper identify' writes model files"


class ModelFileError(PepperError, ValueError):
    """A model file cannot be read or written, is damaged, or belongs to another robot."""


@validated_dataclass(frozen=True, kw_only=True, config=STRICT)
class _Header:
    """Content of a file except the models."""

    format: Literal[2]
    robot: str
    joint_names: tuple[str, ...]
    identity: str
    kind: ModelKind
    cycle: Positive
    estimation_fit: dict[str, float]
    test_fit: dict[str, float]
    threshold: dict[str, Positive]
    version: str
    created_by: str
    base: BaseModel | None = None
    measured: MeasuredRobot | None = None


@dataclass(frozen=True, kw_only=True)
class ModelSet:
    """Models of the joints of one robot, and their origin.

    Attributes:
        robot: Name of the robot description.
        joint_names: Order of the robot's joints.
        identity: Identity of the robot they were identified on: hash of the plant, or body id of a real robot.
        kind: Kind of the models.
        cycle: Period of the ticks [s].
        estimation_fit: By joint, mean NRMSE fit of the estimation runs [%].
        test_fit: By joint, NRMSE fit of the test run [%].
        threshold: By joint, bound of the residual in free motion [rad].
        version: Version of the package that fitted them.
        models: By joint; joints without a model stay blind.
        created_by: Command that made them.
        base: Model of the base twist; mode ``fusion`` only.
        measured: Facts about the robot that were measured before; None where it was not.

    Raises:
        ModelFileError: A model that is not of ``kind``, an unknown joint, no model, fit results of other joints.
    """

    robot: str
    joint_names: tuple[str, ...]
    identity: str
    kind: ModelKind
    cycle: float
    estimation_fit: Mapping[str, float]
    test_fit: Mapping[str, float]
    threshold: Mapping[str, float]
    version: str
    models: Mapping[str, JointModel]
    created_by: str = field(default="pepper identify")
    base: BaseModel | None = None
    measured: MeasuredRobot | None = None

    def __post_init__(self) -> None:
        if not self.models:
            raise ModelFileError("there is no model")
        if len(set(self.joint_names)) != len(self.joint_names):
            raise ModelFileError("a joint is named twice")
        for joint, model in self.models.items():
            if joint not in self.joint_names:
                raise ModelFileError(
                    f"there is a model of '{joint}', which is no joint of the robot"
                )
            if not isinstance(model, MODEL_TYPES[self.kind]):
                raise ModelFileError(
                    f"the model of {joint} is a {type(model).__name__}, not of kind '{self.kind}'"
                )
        for name in ("estimation_fit", "test_fit", "threshold"):
            by_joint: Mapping[str, float] = getattr(self, name)
            if by_joint.keys() != self.models.keys():
                raise ModelFileError(f"'{name}' is not of the joints that have models")
            if not all(math.isfinite(value) for value in by_joint.values()):
                raise ModelFileError(f"'{name}' is not finite")

    def check_robot(self, robot: RobotConfig) -> None:
        """Refuse to be used on another robot.

        Raises:
            ModelFileError: Another robot, other joints or another order of them, another cycle.
        """
        if self.robot != robot.name:
            raise ModelFileError(
                f"these models are of robot '{self.robot}', not of '{robot.name}'; {_REMEDY}"
            )
        if self.joint_names != robot.joint_names:
            raise ModelFileError(
                f"these models are of a '{self.robot}' with other joints or another order of them; {_REMEDY}"
            )
        if self.cycle != robot.cycle:
            raise ModelFileError(
                f"these models are of a robot with a cycle of {self.cycle} s, not {robot.cycle} s; {_REMEDY}"
            )

    def save(self, path: Path) -> None:
        """Write the file; at no time is there half a file at ``path``. Equal sets give equal bytes.

        Raises:
            OutputError: The place cannot be written to.
        """
        with replacing(path) as partial:
            partial.write_text(self._text(), encoding="utf-8")

    def sha256(self) -> str:
        """Return the hash of the file that :meth:`save` writes, in hexadecimal digits."""
        return hashlib.sha256(self._text().encode()).hexdigest()

    def _text(self) -> str:
        header = {f.name: getattr(self, f.name) for f in fields(self) if f.name != "models"}
        # One line per joint, so that differences between files are readable.
        lines = [
            f"  {json.dumps(joint)}: {self._model_text(joint)}"
            for joint in self.joint_names
            if joint in self.models
        ]
        head = json.dumps({"format": FORMAT, **header}, indent=1, allow_nan=False, default=_plain)
        body = ",\n".join(lines)
        return head.removesuffix("\n}") + ',\n "models": {\n' + body + "\n }\n}\n"

    def _model_text(self, joint: str) -> str:
        return json.dumps(asdict(self.models[joint]), allow_nan=False)

    @classmethod
    def load(cls, path: Path | str, robot: RobotConfig | None = None) -> Self:
        """Read a file.

        Args:
            path: File that ``save`` wrote.
            robot: If given, the models must be of this robot.

        Raises:
            ModelFileError: In one line: file, reason, remedy.
        """
        path = as_path("models", path)
        try:
            text = path.read_bytes()
        except OSError as error:
            raise ModelFileError(f"{path}: cannot be read ({reason(error)}); {_SOURCE}") from error
        if not text.lstrip().startswith(b"{"):
            raise ModelFileError(f"{path}: not a model file; {_SOURCE}")
        # JSON allows NaN and repeated keys in Python: a damaged file must not give a model.
        try:
            data = json.loads(
                text.decode("utf-8"),
                parse_float=_finite,
                parse_constant=_refuse_constant,
                object_pairs_hook=_unique,
            )
        except (ValueError, RecursionError) as error:
            raise _damaged(path, error) from error
        if not isinstance(data, dict) or "format" not in data:
            raise ModelFileError(f"{path}: not a model file; {_SOURCE}")
        if data["format"] != FORMAT:
            raise ModelFileError(
                f"{path}: format {json.dumps(data['format'])[:20]} is not the format {FORMAT} "
                f"of this version; {_REMEDY}"
            )
        models = data.pop("models", None)
        try:
            if not isinstance(models, dict):
                raise ModelFileError("there are no models")
            header = parse(_Header, data, "header")
            model_set = cls(
                models={
                    joint: _model(header.kind, entry, joint) for joint, entry in models.items()
                },
                **{f.name: getattr(header, f.name) for f in fields(cls) if f.name != "models"},
            )
        except (ConfigError, ModelFileError) as error:
            raise _damaged(path, error) from error
        if robot is not None:
            try:
                model_set.check_robot(robot)
            except ModelFileError as error:
                raise ModelFileError(f"{path}: {error}") from None
        return model_set


def shipped(kind: ModelKind) -> dict[str, Path]:
    """Return the shipped models of ``kind``, by the plant they were identified on."""
    folder = Path(str(files("pepper_driver.observer.models")))
    suffix = f"-{kind}.json"
    paths = sorted(folder.glob(f"*{suffix}"))
    return {path.name.removesuffix(suffix): path for path in paths}


def load_shipped(kind: ModelKind, identities: Sequence[RobotIdentity]) -> ModelSet:
    """Return the shipped models for a robot.

    Args:
        kind: Kind of the models.
        identities: Identities of the robot and of those whose models it may use, the nearest first.

    Raises:
        ModelFileError: No shipped model fits.
    """
    plants = shipped(kind)
    models = {found.identity: found for found in map(ModelSet.load, plants.values())}
    for robot in identities:
        if robot.identity in models:
            return models[robot.identity]
    raise ModelFileError(
        f"no models come with the package for '{identities[0].name}', only for the plants {', '.join(plants)} "
        f"as they were shipped and plants that extend them; {_REMEDY}"
    )


def _model(kind: ModelKind, entry: object, joint: str) -> JointModel:
    if not isinstance(entry, dict):
        raise ModelFileError(f"the model of {joint} is no mapping")
    return parse(MODEL_TYPES[kind], entry, f"model of {joint}")


def _plain(value: BaseModel | MeasuredRobot | Mapping[str, float]) -> dict[str, Any]:
    return dict(value) if isinstance(value, Mapping) else asdict(value)


def _finite(text: str) -> float:
    value = float(text)
    # A number such as 1e999 is valid JSON, and becomes infinity.
    if not math.isfinite(value):
        raise ValueError(f"{text[:20]} is not finite")
    return value


def _refuse_constant(text: str) -> NoReturn:
    raise ValueError(f"{text} is not finite")


def _unique(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    mapping = dict(pairs)
    if len(mapping) != len(pairs):
        raise ValueError("a key is given twice")
    return mapping


def _damaged(path: Path, error: Exception) -> ModelFileError:
    return ModelFileError(f"{path}: damaged: {short_reason(error)}; {_REMEDY}")


JointModel = Tree | FusionModel


def predict_recording(model: JointModel, joint: str, recording: Recording) -> FloatArray:
    """Predict the (n,) tracking error of a joint over a run [rad], without its measurements.

    A fusion model takes only the first position from the recording.
    """
    index = recording.joint_names.index(joint)
    if not isinstance(model, FusionModel):
        return model.predict(recording.features(index))
    sent = recording.sent_position[:, index]
    states = StickSlipModel.from_parameters([model.twin], recording.cycle).play(
        0, float(recording.position[0, index]), sent, recording.load_torque[:, index]
    )
    error: FloatArray = sent - states["position"]
    return error
