import click
@click.command("plot")
def command(): pass
