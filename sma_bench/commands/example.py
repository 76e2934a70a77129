"""sma-bench example: the files of a documentation page, or a rig's parameters, in a new folder."""

import shutil
from pathlib import Path
from types import SimpleNamespace

from sma_bench.commands import options
from sma_bench.commands.terminal import say
from sma_bench.errors import InputError, did_you_mean
from sma_bench.installation import share_directory


@options.command("example")
def run(args: SimpleNamespace) -> int:
    share = share_directory()
    files = {folder.name: {path.name: path for path in sorted(folder.iterdir())}
             for folder in sorted((share / "examples").iterdir())
             if (folder / "lab.yaml").is_file()}
    files |= {rig.stem: {"lab.yaml": rig} for rig in sorted((share / "config").glob("*_rig.yaml"))}
    if args.name is None:
        for name, found in files.items():
            say(f"{name}: {', '.join(found)}")
        return 0
    if args.name not in files:
        hint = did_you_mean(args.name, files) or f", expected one of {', '.join(files)}"
        raise InputError(f"no example {args.name!r}{hint}")
    folder = Path(args.out or args.name)
    options.keep_safe({"--out": (folder, options.FOLDER)}, [], args.force)
    folder.mkdir(parents=True, exist_ok=True)
    for name, path in files[args.name].items():
        shutil.copyfile(path, folder / name)
        say(f"{folder / name}")
    return 0
