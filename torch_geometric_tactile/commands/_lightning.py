r"""Commands whose arguments Lightning parses, and their short help."""

from collections.abc import Callable, Sequence

from torch_geometric_tactile.commands._paths import expand_home

FULL_HELP = ("--help-all", "--help=all")

_OPTIONS = (
    ("--config FILE", "a YAML file, or the name of a shipped configuration;", "may be repeated"),
    ("--model.model CLASS", "the network, such as TaxelNet"),
    (
        "--data.dataset.init_args.root DIR",
        "folder of the data; the same for test_dataset",
        "(default: a folder in $TACTILE_DATA)",
    ),
    ("--trainer.max_epochs N", "number of epochs"),
    ("--data.batch_size N", "samples per batch (default: 128)"),
    ("--model.optimizer.init_args.lr RATE", "learning rate (default: from the configuration)"),
    ("--seed_everything N", "seed of all randomness (default: 0)"),
    ("--ckpt_path FILE", "{checkpoint}"),
    (
        "--trainer.devices N",
        "number of GPUs, or of processes on a CPU",
        "(default: all GPUs, or one process)",
    ),
    ("--out DIR", "folder of the runs (default: runs)"),
)
_FIT_OPTIONS = ("--trainer.max_epochs", "--model.optimizer.init_args.lr")
_COLUMN = 40  # where the texts of the options start


def lightning_command(
    name: str, description: str, checkpoint: str, examples: str
) -> Callable[[Sequence[str]], int]:
    r"""Returns a function that runs a command of Lightning with the given arguments and returns
    the exit status.

    Args:
        name (str): Name of the command, such as :obj:`"fit"`.
        description (str): Description in the short help.
        checkpoint (str): Help text of the option :obj:`--ckpt_path`.
        examples (str): Examples at the end of the short help.
    """

    def run_raw(arguments: Sequence[str]) -> int:
        if {"-h", "--help"} & {*arguments}:
            print(short_help(name, description, checkpoint, examples))
            return 0
        if not arguments:
            raise ValueError(
                "'--config' must name a configuration: a YAML file or a shipped one, such as "
                f"grasp_gcn_df (got none); see 'tactile {name} --help'"
            )
        from torch_geometric_tactile.training import _lightning_cli as lightning_cli

        lightning_arguments = [
            "--help" if argument in FULL_HELP else expand_home(argument) for argument in arguments
        ]
        lightning_cli.run_lightning([name, *lightning_arguments])
        return 0

    return run_raw


def short_help(name: str, description: str, checkpoint: str, examples: str) -> str:
    r"""Returns a short help of a command: the most important options, and how to list all
    options.
    """
    lines = [f"usage: tactile {name} --config FILE [options]", "", description.strip(), ""]
    lines.append("main options:")
    for option, *texts in _OPTIONS:
        if name != "fit" and option.startswith(_FIT_OPTIONS):
            continue
        texts = [text.replace("{checkpoint}", checkpoint) for text in texts]
        lines.append(f"  {option:{_COLUMN - 2}}{texts[0]}")
        lines += [f"{'':{_COLUMN}}{text}" for text in texts[1:]]
    lines += ["", "help:"]
    for option, text in (
        ("-h, --help", "this page"),
        ("--help-all", "all options of trainer, model and data (long)"),
        ("--model.model.help CLASS", "the arguments of a network"),
        ("--data.dataset.help CLASS", "the arguments of a data set"),
        ("--print_config", "print the whole configuration and exit"),
    ):
        lines.append(f"  {option:{_COLUMN - 2}}{text}")
    return "\n".join([*lines, "", examples.rstrip()])
