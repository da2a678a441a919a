"""Who owns the import name `fluidgym` in this Python environment."""

from importlib import metadata


def check_import_name() -> None:
    """Refuse to go on where the unrelated distribution `fluidgym` is installed too.

    Both distributions put their files into one folder `fluidgym`, so whichever came second has
    overwritten part of the other.

    Raises:
        ImportError: A distribution named `fluidgym` is installed beside `fluidgym-sph`.
    """
    try:
        other = metadata.distribution("fluidgym")
    except metadata.PackageNotFoundError:
        return
    raise ImportError(
        f"The distributions fluidgym {other.version} and fluidgym-sph both install the import name "
        "`fluidgym` and cannot share an environment; run `pip uninstall fluidgym`, then "
        "`pip install --force-reinstall --no-deps fluidgym-sph`, or use a fresh environment."
    )
