"""Networks: their sizes, what turns of an image they see, and weights from their generator alone."""

import pytest
import torch

from deepgps.config.learning import Architecture, NetworkSettings
from deepgps.learning.networks import PADDING, count_parameters, make_network, pad


def build(architecture: Architecture, seed: int = 0, **more):
    settings = NetworkSettings(architecture=architecture, width=16, layers=2, channels=8, **more)
    return make_network(settings, 10, 3, torch.Generator().manual_seed(seed)).eval()


def test_spectral_network_maps_features_to_outputs():
    network = build("spectral")
    assert network(torch.zeros(5, 10)).shape == (5, 3)
    assert count_parameters(network) == (10 * 16 + 16) + (16 * 16 + 16) + (16 * 3 + 3)


def test_resnets_map_images_of_any_size_to_outputs():
    for architecture in PADDING:
        for size in ((8, 32), (16, 64)):
            assert build(architecture)(torch.rand(2, 3, *size)).shape == (2, 3)


def test_resnet18_has_the_size_of_a_resnet18_with_a_small_first_kernel():
    network = make_network(NetworkSettings(architecture="resnet"), 0, 1000, torch.Generator())
    # torchvision's ResNet-18 has 11,689,512 parameters; its first kernel is 7 x 7 over 3 colours.
    assert count_parameters(network) == 11_689_512 - 64 * 3 * (7 * 7 - 3 * 3)


def test_resnet_does_not_see_turns_by_its_stride_and_zeros_beyond_the_edge_see_every_turn():
    image = torch.rand(2, 3, 32, 128)
    for architecture in ("resnet", "resnet_paper"):
        network = build(architecture)
        assert torch.allclose(network(image), network(image.roll(32, dims=3)), atol=1e-5)
        assert not torch.allclose(network(image), network(image.roll(32, dims=1)), atol=1e-5)
    network = build("resnet_plain")
    for sectors in (32, 1):
        assert not torch.allclose(network(image), network(image.roll(sectors, dims=3)), atol=1e-4)


@pytest.mark.parametrize("sectors", [32, *(pytest.param(n, marks=pytest.mark.slow) for n in (64, 96))])
def test_invariant_is_the_mean_of_resnet_over_all_turns(sectors: int):
    invariant, resnet, image = build("invariant"), build("resnet"), torch.rand(3, 3, 16, sectors)
    turned = torch.stack([resnet(image.roll(turn, dims=3)) for turn in range(sectors)])
    assert torch.allclose(invariant(image), turned.mean(dim=0), atol=1e-5)
    assert (turned.std(dim=0) > 1e-4).any()
    for turn in range(sectors):
        assert torch.allclose(invariant(image), invariant(image.roll(turn, dims=3)), atol=1e-5)


def test_invariant_trains_as_resnet_does():
    invariant, resnet, image = build("invariant").train(), build("resnet").train(), torch.rand(4, 3, 16, 64)
    assert torch.equal(invariant(image), resnet(image))


def test_only_the_paper_variant_joins_zenith_and_rim():
    image = torch.rand(2, 3, 64, 128)
    paper, ours = build("resnet_paper"), build("resnet")
    assert torch.allclose(paper(image), paper(image.roll(32, dims=2)), atol=1e-5)
    assert not torch.allclose(ours(image), ours(image.roll(32, dims=2)), atol=1e-5)
    assert torch.equal(pad(image, 1, PADDING["resnet_paper"])[..., 0, 1:-1], image[..., -1, :])
    assert pad(image, 1, PADDING["resnet"])[..., 0, :].abs().max() == 0.0
    assert torch.equal(pad(image, 1, PADDING["resnet"])[..., 1:-1, 0], image[..., -1])
    assert pad(image, 1, PADDING["resnet_plain"])[..., 0].abs().max() == 0.0


@pytest.mark.parametrize("architecture", ["spectral", "resnet"])
def test_weights_come_from_the_generator_alone(architecture: Architecture):
    before = torch.random.get_rng_state()
    first, same, other = (build(architecture, seed).state_dict() for seed in (0, 0, 1))
    assert all(torch.equal(first[name], same[name]) for name in first)
    assert any(not torch.equal(first[name], other[name]) for name in first)
    assert torch.equal(before, torch.random.get_rng_state())
