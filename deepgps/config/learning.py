"""Settings of learning: frozen groups, each checked once when it is created."""

from collections.abc import Collection
from typing import Literal

from pydantic import AfterValidator, Field
from pydantic_core import PydanticCustomError

from sim.settings import Group
from sim.settings.group import Seed

Architecture = Literal["spectral", "invariant", "resnet", "resnet_paper", "resnet_plain"]
PairLoss = Literal["absolute", "normalised"]
PixelValues = Literal["pixels", "ranks"]
Start = Literal["auto", "paths", "ends", "lifting", "random"]


def one_of(names: Collection[str]) -> AfterValidator:
    """A check that a value is one of these names."""
    return AfterValidator(lambda value: check_name(value, names))


def check_name(value: str, names: Collection[str], hint: str = "") -> str:
    """Raise an error if a value is none of these names, with the same message as a Literal of them and a hint."""
    if value not in names:
        *most, last = map(repr, names)
        allowed = f"{', '.join(most)} or {last}{hint}"
        raise PydanticCustomError("literal_error", "Input should be {allowed}", {"allowed": allowed})
    return value


class FeatureSettings(Group):
    """Spectral features, the input of the spectral network and of the nearest-neighbour method."""

    frequencies: int = Field(default=16, ge=1, le=512)
    """Highest frequency kept around the circle."""
    values: PixelValues = "pixels"
    """What of an image's pixels is described. pixels: their values; ranks: their ranks within the image, for each
    colour, which no monotone change of the light alters."""
    rings: int = Field(default=16, ge=1, le=256)
    """Rings that a lidar scan is converted to, each filled equally often."""
    principal: int = Field(default=512, ge=2, le=4096)
    """Principal components in which slow features are searched for."""
    components: int = Field(default=256, ge=2, le=4096)
    """Slow features kept."""
    noise: float = Field(default=0.15, ge=0.0, le=10.0)
    """Standard deviation of the noise added to features in training; the features' own root mean square is 1."""


class NetworkSettings(Group):
    """The network that maps one observation to one position."""

    architecture: Architecture = "spectral"
    """spectral: fully connected layers on spectral features; resnet: ResNet-18 with circular padding of the sectors;
    resnet_paper: circular padding of sectors and rings; resnet_plain: zero padding at all edges; invariant: a resnet
    that, after training, predicts the mean over all rotations of an image."""
    width: int = Field(default=256, ge=4, le=4096)
    """Neurons in each layer of the spectral network."""
    layers: int = Field(default=6, ge=1, le=16)
    """Hidden layers of the spectral network."""
    channels: int = Field(default=64, ge=4, le=256)
    """Channels of the ResNet's first stage (ResNet-18: 64)."""


class TrainSettings(Group):
    """The training loop, shared by every method that trains a network. Budgets are in steps, never in seconds."""

    steps: int = Field(default=5000, ge=1, le=10_000_000)
    """Steps of the optimiser."""
    segments: int = Field(default=32, ge=1, le=4096)
    """Segments in a batch; a supervised batch holds segments times samples observations."""
    shift: bool = True
    """Shift each image of a batch around the circle at random, as if the robot had turned; features do not need it."""
    samples: int = Field(default=8, ge=2, le=1024)
    """Samples drawn from each segment of a batch; all their pairs are used."""
    learning_rate: float = Field(default=4e-3, gt=0.0, le=1.0)
    """Peak learning rate of Adam; the rate rises over the first steps and then falls as a cosine."""
    weight_decay: float = Field(default=1e-4, ge=0.0, le=1.0)
    """Weight decay (AdamW)."""
    checkpoint_steps: int = Field(default=500, ge=1)
    """Steps between two checkpoints."""
    snapshots: int = Field(default=30, ge=2, le=1000)
    """Number of steps, from the first to the last, at which predictions are kept to show how the map unfolds."""
    device: str = Field(default="cpu", pattern=r"^(cpu|cuda(:\d{1,3})?|auto)$")
    """cpu, cuda, cuda:N, or auto: CUDA if the machine has a CUDA device."""
    threads: int = Field(default=1, ge=1, le=256)
    """Threads on a CPU. One is as fast as more for the spectral network, and on a busy machine many times faster."""
    bfloat16: bool = True
    """Compute matrix products in bfloat16 where that is faster on this processor; the weights stay float32."""


class LiftSettings(Group):
    """Lifting: the network predicts in more dimensions than two, in which a map can unfold and is flattened later."""

    dimensions: int = Field(default=8, ge=2, le=64)
    """Dimensions before flattening; 2: no lifting."""
    penalty: float = Field(default=1.0, ge=0.0, le=1e6)
    """Weight of the full penalty."""


class FoldSettings(Group):
    """The fold detector, which does not use the truth, and the restarts after it finds a fold."""

    restarts: int = Field(default=1, ge=0, le=20)
    """How often training may restart after a fold is found; if start is auto, restarts use lifting."""


class ExplicitSettings(Group):
    """Explicit positioning, which solves for landmarks and positions at once; only where distances are observed."""

    readings: int = Field(default=2000, ge=3, le=1_000_000)
    """Maximum number of readings, spread over the segments, whose positions are unknowns."""
    evaluations: int = Field(default=100, ge=1, le=100_000)
    """Maximum number of function evaluations of the solver."""


class PcaSettings(Group):
    """The nearest neighbour among scans at many headings, by principal components; only where scans are observed."""

    headings: int = Field(default=100, ge=1, le=4096)
    """Maximum number of headings stored at each position (the paper: 100)."""


class LearnSettings(Group):
    """Everything that determines how a method learns from a recording."""

    seed: Seed | None = None
    """Seed of weights and random draws; None: the scenario's seed."""
    features: FeatureSettings = FeatureSettings()
    network: NetworkSettings = NetworkSettings()
    train: TrainSettings = TrainSettings()
    loss: PairLoss = "absolute"
    """Loss of each pair in a segment. absolute: |d - c| (Eq. 2); normalised: |d - c| / (d + c) (Eq. 3)."""
    straight: float = Field(default=5.0, ge=0.0, le=1e6)
    """Weight of the distance of predictions from the straight line that was driven; 0: the paper's loss alone."""
    start: Start = "auto"
    """How the map is unfolded before the distances refine it: paths (the network imitates an initial map; most segments
    need three readings), ends (the same for segments with two readings), lifting, random (not at all), or auto: paths
    where possible, else lifting."""
    explicit: ExplicitSettings = ExplicitSettings()
    pca: PcaSettings = PcaSettings()
    lift: LiftSettings = LiftSettings()
    fold: FoldSettings = FoldSettings()
