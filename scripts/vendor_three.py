"""Bundle the used parts of three.js into one file, `alfmu/view/vendor/three.min.js`, with its licence.

    python scripts/vendor_three.py            write both files
    python scripts/vendor_three.py --check    exit with 1 where they differ from what would be written

Needs npm and, once, a package registry. `three/package.json` pins the versions, `three/package-lock.json` their
contents; for another version, change the former, run `npm install --package-lock-only` there, then this script.
"""

import argparse
import json
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

SOURCE = Path(__file__).parent / "three"
VENDOR = Path(__file__).parents[1] / "alfmu" / "view" / "vendor"
BUNDLE, LICENCE = "three.min.js", "three.LICENSE"


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--check", action="store_true", help="compare only")
    chosen = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        made = bundled(Path(folder))
    old = {name: (VENDOR / name).read_bytes() if (VENDOR / name).exists() else b"" for name in made}
    if chosen.check:
        for name, content in made.items():
            print(f"{name}: {'the same' if content == old[name] else 'differs'}")
        return int(made != old)
    for name, content in made.items():
        (VENDOR / name).write_bytes(content)
        print(f"wrote {name} ({len(content) / 1000:.0f} kB)")
    return 0


def bundled(folder: Path) -> dict[str, bytes]:
    """Return the bundle and the licence, by name."""
    for path in SOURCE.iterdir():
        shutil.copy(path, folder)
    subprocess.run(["npm", "ci", "--silent", "--ignore-scripts"], cwd=folder, check=True)
    wanted = json.loads((folder / "package.json").read_text())["dependencies"]["three"]
    options = [
        "--bundle",
        "--minify",
        "--format=iife",
        "--global-name=THREE",
        "--legal-comments=none",
        "--target=es2020",
    ]
    options += [
        f"--banner:js=/* three.js {wanted}, MIT licence: three.LICENSE */",
        "--outfile=bundle.js",
        "--log-level=error",
    ]
    # The wrapper in esbuild's package finds its program even if installation scripts are disabled.
    subprocess.run(["node_modules/.bin/esbuild", "three.js", *options], cwd=folder, check=True)
    text = (folder / "bundle.js").read_text(encoding="utf-8").replace("</script", "<\\/script")
    licence = (folder / "node_modules" / "three" / "LICENSE").read_bytes()
    return {BUNDLE: text.encode(), LICENCE: licence}


if __name__ == "__main__":
    sys.exit(main())
