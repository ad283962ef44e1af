"""Small zip files in the form of PhysioNet's pressure mat data."""

import hashlib
import zipfile


def mat_files():
    """The files of two persons: ten frames of three postures, and four single frames."""
    files = {}
    for person in (1, 2, 10):
        for posture in (1, 3, 13):
            frames = [[person, posture, t, *range(2045)] for t in range(5)]
            files[f"experiment-i/S{person}/{posture}.txt"] = frames
        for mattress in ("Air", "Sponge"):
            for posture in ("B1", "B10", "C2", "E3", "G1"):
                rows = [[person, len(mattress), r, *range(24)] for r in range(64)]
                name = f"experiment-ii/S{person}/{mattress}_Mat/Matrix_{mattress}_{posture}.txt"
                files[name] = rows
    return {
        name: "".join("\t".join(map(str, row)) + "\t\r\n" for row in rows).encode()
        for name, rows in files.items()
    }


def checksums(files):
    """The list of checksums."""
    lines = [f"{hashlib.sha256(data).hexdigest()} {name}\n" for name, data in files.items()]
    return "".join(lines).encode()


def write_mat(path, files=None, sums=None):
    """Writes a zip file."""
    files = mat_files() if files is None else files
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("pmd-1.0.0/SHA256SUMS.txt", checksums(files) if sums is None else sums)
        for name, data in files.items():
            archive.writestr(f"pmd-1.0.0/{name}", data)
    return path
