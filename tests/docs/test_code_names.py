"""The pages name code that exists: files by their path, and modules, functions and parameters of an estimator.

So do the docstrings of the estimators and of the conformance suite.
"""

import ast
import re
from pathlib import Path

import pytest

from tools.site import parts

ROOT = Path(__file__).parents[2]
PAGES = sorted([*ROOT.glob("*.md"), *(ROOT / "docs").glob("*.md")], key=lambda page: page.name)
ESTIMATORS = sorted(
    folder.name for folder in (ROOT / "estimators").iterdir() if (ROOT / "docs" / f"{folder.name}.md").exists()
)
PARTS = sorted(part.name for part in (ROOT / "stridetwin").iterdir() if part.is_dir())
PACKAGES = (*PARTS, "tools", "tests", "benchmarks")
DOCUMENTED = ("estimators", "testing")
COMPOSED = {"foot_ins_l", "standing_l", "standing_r"}
"""Names that the code composes of parts."""
OUTPUTS = ("csv", "json", "mcap", "ply", "glb", "txt", "html", "yaml")


def code_of(text):
    """What stands between backticks outside of fenced code."""
    prose = "".join(part for fenced, part in parts(text) if not fenced)
    return re.findall(r"(?<!`)`([^`\n]+)`(?!`)", prose)


def missing_files(text):
    """Modules and folders of the repository that a page names and that do not exist."""
    paths = {name for name in code_of(text) if re.fullmatch(rf"(?:{'|'.join(PACKAGES)})/(?:[\w./]*(?:/|\.py))?", name)}
    return sorted(path for path in paths if not (ROOT / path).exists())


def missing_names(text, package):
    """Names below "How it works" that the sources of a package do not contain.

    `module.py` is a file of the package, `module.name` a top-level function or class of it, and any other identifier
    with an underscore a word of its sources.
    """
    text = text.split("## How it works", 1)[-1].split("## How accurate it is", 1)[0]
    sources = {file.stem: file.read_text(encoding="utf-8") for file in package.rglob("*.py")}
    words = set(re.findall(r"\w+", "\n".join(sources.values())))
    missing = []
    for name in code_of(text):
        if module := re.fullmatch(r"(\w+)\.py", name):
            exists = module[1] in sources
        elif dotted := re.fullmatch(r"([a-z_]+)\.(\w+)", name):
            exists = dotted[2] in OUTPUTS or re.search(
                rf"^(?:def|class) {dotted[2]}\b", sources.get(dotted[1], ""), re.M
            )
        else:
            exists = not re.fullmatch(r"[a-z]+(?:_[a-z0-9]+)+", name) or name in words
        if not exists:
            missing.append(name)
    return missing


def words_of(source):
    """Words of a module's code and of its texts, without docstrings and comments."""
    return set(re.findall(r"\w+", re.sub(r'"""[\s\S]*?"""|#[^\n]*', "", source)))


def missing_docstring_names(source, words, modules):
    """Names between backticks in the docstrings of a module, those below constants included, that no code has.

    Each part of a dotted name is a word of the code; of `module.name`, the name is one of that module.

    Args:
        source: Source of the module.
        words: All words of the code, and names of modules.
        modules: Words of each module that is named with its functions.
    """
    missing = set()
    for node in ast.walk(ast.parse(source)):
        match node:
            case ast.Expr(value=ast.Constant(value=str(text))):
                for name in re.findall(r"(?<!`)`([^\W\d]\w*(?:\.\w+)*)`(?!`)", text):
                    first, *others = name.removesuffix(".py").split(".")
                    exists = words.issuperset([first, *others])
                    if others and first in modules:
                        exists = others[0] in modules[first]
                    if not exists and name not in COMPOSED:
                        missing.add(name)
    return sorted(missing)


def words_of_modules(folder):
    """Words of the modules in a folder by name; those of a package are the names of its modules and what it exports."""
    modules = {file.stem: words_of(file.read_text(encoding="utf-8")) for file in folder.glob("*.py")}
    for package in folder.glob("*/__init__.py"):
        names = {file.stem for file in package.parent.glob("*.py")}
        modules[package.parent.name] = names | words_of(package.read_text(encoding="utf-8"))
    return modules


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.stem)
def test_files_that_a_page_names_exist(page):
    assert missing_files(page.read_text(encoding="utf-8")) == []


@pytest.mark.parametrize("name", ESTIMATORS)
def test_code_that_an_estimator_s_page_cites_exists(name):
    text = (ROOT / "docs" / f"{name}.md").read_text(encoding="utf-8")
    assert missing_names(text, ROOT / "estimators" / name) == []


def test_code_that_docstrings_cite_exists():
    files = [file for folder in PACKAGES if folder != "tests" for file in (ROOT / folder).rglob("*.py")]
    words = {word for file in files for word in words_of(file.read_text(encoding="utf-8"))} | {f.stem for f in files}
    words |= {file.parent.name for file in files}
    missing = {}
    for folder in DOCUMENTED:
        common = words_of_modules(ROOT / folder)
        for file in (ROOT / folder).rglob("*.py"):
            modules = common | words_of_modules(file.parent)
            if names := missing_docstring_names(file.read_text(encoding="utf-8"), words, modules):
                missing[file.relative_to(ROOT).as_posix()] = names
    assert missing == {}


def test_missing_code_is_found(tmp_path):
    (tmp_path / "gain.py").write_text("def gain(noise_sd): ...\n", encoding="utf-8")
    cited = "`gain.py`, `gain.gain`, `noise_sd`, `loss.py`, `gain.loss`, `bias_sd`"
    page = f"`sim/nowhere.py`, `sim/`\n## How it works\n{cited}\n## How accurate it is\n`x_y`\n"
    assert missing_files(page) == ["sim/nowhere.py"]
    assert missing_names(page, tmp_path) == ["loss.py", "gain.loss", "bias_sd"]
    source = f'"""By {cited}, `sd.value` and `gain`."""\nnoise_sd = gain = sd = 0\n'
    words = words_of(source)
    assert missing_docstring_names(source, words, {"gain": {"gain"}}) == ["bias_sd", "gain.loss", "loss.py", "sd.value"]
