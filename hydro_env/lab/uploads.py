"""Files that a page was given: kept in a temporary folder under plain names, bounded, and gone when the lab ends."""

import asyncio
import re
import tempfile
from collections.abc import AsyncIterator, Mapping
from dataclasses import dataclass
from pathlib import Path

from hydro_env.errors import InputError, shown
from hydro_env.measured.formats import ENDINGS
from hydro_env.measured.mapping import SCHEMA as MAPPING
from hydro_env.plant.model import SCHEMA as MODEL
from hydro_env.plant.model_files import preset_names
from hydro_env.reading import read_yaml

#: Bytes of a file, and files at a time.
MAX_BYTES = 256 * 2**20
MAX_FILES = 20
#: Endings of mappings and models.
YAML_ENDINGS = (".yaml", ".yml")
#: What a YAML file is, by its `schema`.
ROLES = {MODEL: "model", MAPPING: "mapping"}


@dataclass
class Upload:
    """A file: where it is, what the page calls it, and what it is to be: "fit", "held_out", "mapping", "model" or ""."""

    path: Path
    name: str
    role: str


class Uploads:
    """The files of a page. Of what arrives only the schema of a YAML file is read here."""

    def __init__(self) -> None:
        self._folder = tempfile.TemporaryDirectory(prefix="hydro_env_lab_")
        self._count = 0
        self.files: list[Upload] = []

    async def receive(self, name: str, chunks: AsyncIterator[bytes]) -> Upload:
        """Stores what arrives as a file of this name. InputError for an ending that nothing reads, a YAML file that is neither a
        model nor a mapping, and for too much."""
        ending = ending_of(name)
        if len(self.files) >= MAX_FILES:
            raise InputError(f"there are {MAX_FILES} files already; remove some first")
        self._count += 1
        stem = re.sub(r"[^A-Za-z0-9_-]", "_", Path(name).name[: -len(ending)])[:60]
        path = Path(self._folder.name) / f"{self._count}_{stem}{ending}"
        size = 0
        try:
            with path.open("xb") as file:
                async for chunk in chunks:
                    size += len(chunk)
                    if size > MAX_BYTES:
                        most = f"{MAX_BYTES // 2**20} MiB"
                        raise InputError(f"{name}: larger than {most}; export a shorter part")
                    file.write(chunk)
            role = "fit" if ending in ENDINGS else await asyncio.to_thread(role_of, path, name)
        except BaseException:
            path.unlink(missing_ok=True)
            raise
        return self.add(path, str(InputError(Path(name).name)), role)

    def add(self, path: Path, name: str, role: str) -> Upload:
        """Lists a file that lies elsewhere."""
        upload = Upload(path, name, role)
        self.files.append(upload)
        return upload

    def remove(self, upload: Upload) -> None:
        """Takes a file off the list, and deletes it if it was uploaded."""
        self.files.remove(upload)
        if upload.path.parent == Path(self._folder.name):
            upload.path.unlink(missing_ok=True)

    def store(self, file: str, text: str, name: str, role: str) -> None:
        """Lists a text, as a file of the temporary folder."""
        path = Path(self._folder.name) / file
        path.write_text(text, encoding="utf-8")
        self.add(path, name, role)

    def with_role(self, role: str) -> list[Path]:
        """The files of a role, in their order."""
        return [upload.path for upload in self.files if upload.role == role]

    def rigs(self, chosen: str) -> dict[str, str]:
        """What can be driven and diagnosed, with its name: presets, models that are here, and what is chosen."""
        models = {str(each.path): each.name for each in self.files if each.role == "model"}
        return {chosen: Path(chosen).name} | {name: name for name in preset_names()} | models

    def close(self) -> None:
        """Deletes all that was uploaded."""
        self.files.clear()
        self._folder.cleanup()


def role_of(path: Path, name: str) -> str:
    """What a YAML file says that it is: "model" or "mapping". InputError, which calls it by `name`, if it is neither."""
    try:
        data = read_yaml(path, "a model or a mapping in YAML")
    except InputError as problem:
        raise InputError(str(problem).replace(str(path), name)) from None
    schema = data.get("schema") if isinstance(data, Mapping) else None
    if not isinstance(schema, str) or schema not in ROLES:
        known = " or ".join(f"`schema: {each}` for a {role}" for each, role in ROLES.items())
        raise InputError(f"{name}: schema is {shown(schema)}, expected {known}")
    return ROLES[schema]


def ending_of(name: str) -> str:
    """The ending of a file's name, in lower case. InputError for one that nothing reads."""
    for ending in sorted((*ENDINGS, *YAML_ENDINGS), key=len, reverse=True):
        if name.lower().endswith(ending):
            return ending
    raise InputError(f"{shown(name)}: expected a log ({', '.join(ENDINGS)}), or a mapping or model in YAML")
