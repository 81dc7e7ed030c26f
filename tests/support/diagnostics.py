"""Archives for support, read again."""

import io
import tarfile
from collections.abc import Mapping


def files_of(content: bytes) -> Mapping[str, str]:
    """Return the texts in an archive of `stonefall diagnostics` by their names."""
    texts = {}
    with tarfile.open(fileobj=io.BytesIO(content)) as tar:
        for name in tar.getnames():
            file = tar.extractfile(name)
            assert file is not None
            texts[name.removeprefix("stonefall-diagnostics/")] = file.read().decode()
    return texts
