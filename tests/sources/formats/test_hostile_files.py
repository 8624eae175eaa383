"""Files that would have the reader look elsewhere, or run what is not its own."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from chachart.node.data.errors import SetupError
from chachart.sources.formats.hdf5 import open_capture
from chachart.sources.formats.npz import open_capture as open_npz

h5py = pytest.importorskip("h5py")


def test_datasets_that_keep_their_data_in_other_files_are_refused(tmp_path: Path) -> None:
    secret = tmp_path / "secret"
    secret.write_bytes(b"the secret" * 100)
    with h5py.File(tmp_path / "a.h5", "w") as file:
        file.create_dataset("csi", (100,), "u1", external=[(str(secret), 0, 100)])
    with pytest.raises(SetupError, match=r"a\.h5: /csi keeps its data in other files"):
        open_capture(tmp_path / "a.h5")
    with h5py.File(tmp_path / "other.h5", "w") as file:
        file["data"] = np.zeros(4)
    layout = h5py.VirtualLayout((4,), "f8")
    layout[:] = h5py.VirtualSource(str(tmp_path / "other.h5"), "data", (4,))
    with h5py.File(tmp_path / "b.h5", "w") as file:
        file.create_virtual_dataset("csi", layout)
    with pytest.raises(SetupError, match="keeps its data in other files"):
        open_capture(tmp_path / "b.h5")


def test_links_to_other_files_are_not_followed(tmp_path: Path) -> None:
    with h5py.File(tmp_path / "other.h5", "w") as file:
        file["data"] = np.zeros(4)
    with h5py.File(tmp_path / "a.h5", "w") as file:
        file["own"] = np.zeros(4)
        file["far"] = h5py.ExternalLink(str(tmp_path / "other.h5"), "/data")
        file["soft"] = h5py.SoftLink("/own")
    assert list(open_capture(tmp_path / "a.h5").variables) == ["own"]


def test_filters_of_plug_ins_are_refused_and_common_ones_read(tmp_path: Path) -> None:
    with h5py.File(tmp_path / "a.h5", "w") as file:
        for name in ("gzip", "lzf"):
            file.create_dataset(name, data=np.arange(1000), compression=name, shuffle=True, fletcher32=True)
    capture = open_capture(tmp_path / "a.h5")
    np.testing.assert_array_equal(capture.read("gzip"), np.arange(1000))
    plan = h5py.h5p.create(h5py.h5p.DATASET_CREATE)
    plan.set_chunk((10,))
    plan.set_filter(32015, h5py.h5z.FLAG_OPTIONAL, (3,))  # Zstandard, which h5py does not bring
    with h5py.File(tmp_path / "b.h5", "w") as file:
        h5py.h5d.create(file.id, b"csi", h5py.h5t.NATIVE_DOUBLE, h5py.h5s.create_simple((10,)), plan)
    with pytest.raises(SetupError, match="packed by filter 32015"):
        open_capture(tmp_path / "b.h5")


def test_pickles_are_never_opened(tmp_path: Path) -> None:
    np.savez(tmp_path / "a.npz", csi=np.array([{"a": 1}], dtype=object))
    with pytest.raises(SetupError):
        open_npz(tmp_path / "a.npz").read("csi")
