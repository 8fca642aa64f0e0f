"""The drive of the plane world that the tests of maps from distances share."""

import pytest

from tests.helpers.toy import DescribedToy, describe_toy


@pytest.fixture(scope="package")
def toy(tmp_path_factory: pytest.TempPathFactory) -> DescribedToy:
    return describe_toy(tmp_path_factory.mktemp("distances") / "toy", samples=1200)
