"""sma-bench audit: do the numbers of a lab fit each other, and physics?"""

from types import SimpleNamespace

from sma_bench.commands import options
from sma_bench.commands.terminal import print_findings, write_json
from sma_bench.errors import InputError
from sma_bench.parameters.audit import audit


@options.command("audit")
def run(args: SimpleNamespace) -> int:
    """Print every finding; exit code 0 (a clash is a result, not an error)."""
    if args.file and args.params:
        raise InputError(f"audit: {args.file} and --params {args.params} given, expected one file")
    args.params = args.params or args.file
    parameters = options.parameters_from_options(args)
    findings = audit(parameters, papers_own=args.paper or not parameters.given)
    write_json(args.json, {"findings": [finding.to_json() for finding in findings]})
    print_findings(findings)
    clashes = sum(finding.severity != "info" for finding in findings)
    print(f"{clashes} of {len(findings)} checks found a clash")
    return 0
