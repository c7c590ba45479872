import click
@click.command("compile")
def command(): pass
