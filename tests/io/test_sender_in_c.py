import re
import shutil
import subprocess
from pathlib import Path

import numpy as np
import pytest
from streams import fed

pytest.importorskip("cobs", reason="needs the extra 'live'")
compiler = shutil.which("cc")
if compiler is None:
    pytest.skip("needs a C compiler", allow_module_level=True)

from torch_geometric_tactile.io import CobsDecoder, encode_packet  # noqa: E402

PAGE = Path(__file__).parents[2] / "docs" / "serial_formats.md"
MAIN = """
#include <stdio.h>
int main(void) {
  static uint16_t readings[TAXELS * CHANNELS];
  static uint8_t out[SIZE + SIZE / 254 + 3];
  for (int frame = 0; frame < FRAMES; frame++) {
    for (int i = 0; i < TAXELS * CHANNELS; i++) readings[i] = frame % 3 ? 40503 * (frame + i) : 0;
    fwrite(out, 1, make_packet(readings, 1000 * frame, out), stdout);
  }
}
"""


@pytest.mark.parametrize("taxels", [5, 39, 40, 41, 300])  # some with blocks of 254 bytes
def test_the_sender_of_the_page(taxels, tmp_path):
    (code,) = re.findall(r"```c\n(.*?)```", PAGE.read_text(encoding="utf-8"), re.DOTALL)
    code = code.replace("#define TAXELS 5", f"#define TAXELS {taxels}\n#define FRAMES 60")
    (tmp_path / "sender.c").write_text(code + MAIN)
    arguments = ["-Wall", "-Wextra", "-Werror", "-o", "sender"]
    build = subprocess.run(
        [compiler, *arguments, "sender.c"], cwd=tmp_path, capture_output=True, text=True
    )
    assert build.returncode == 0, build.stderr
    data = subprocess.run([tmp_path / "sender"], check=True, capture_output=True, timeout=60).stdout
    expected = b""
    for i in range(60):
        counts = 40503 * (i + np.arange(3 * taxels)) if i % 3 else np.zeros(3 * taxels, int)
        counts = (counts % 2**16).astype(np.uint16).reshape(-1, 3)
        expected += encode_packet(i, counts, i / 1000)
    assert data == expected
    decoder = CobsDecoder()
    assert len(fed(decoder, data, size=50)) == 60
    assert decoder.counts.corrupt == decoder.counts.skipped == 0
