import click
@click.command("check")
def command(): pass
