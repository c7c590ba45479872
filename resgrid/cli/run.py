import click
@click.command("run")
def command(): pass
