"""Conjugate gradients preconditioned by multigrid: the algorithm on one page.

`MultigridFactor` solves ``A x = b`` for the Laplacian of a grid or a netlist, in this order:
1. *Red-black grids* (`grid_level.lay_out`, `red_black.Lattice, Stencil`). A grid has two colours, and every edge
   joins a red cell to a black one: ``A = [[D_r, -G], [-G^T, D_b]]``. Conductances are kept face by face over the red
   cells, in flat arrays without indices, in double precision and in single. Cells are numbered with odd strides, so
   that the neighbour across a face lies at the same distance for all red cells. What fits no face, an edge that closes
   a ring or leads to a node beside the lattice, is an off-stencil coupling.
2. *Coarse grids* (`blocks.coarsen`: `count_inside, join_inside, split_blocks, sum_blocks`). A coarse node is
   the connected part of a block of two cells a side, cut where a conductance is weak beside the strongest at either
   end, so that no node joins across a wall; further parts of a block become nodes beside the lattice. Axes that
   conduct badly are left for later. Middle to middle, two blocks are joined through half of either one's own
   resistance in series with what lies between (plain aggregation makes long ways too easy: Braess 1995).
3. *Graphs* (`graphs.grow_aggregates, sum_up`). Netlists from the first level on, and grids that have fallen apart,
   have aggregates grown node by node along the strongest conductances. A netlist numbered at random is renumbered
   before (`ordering_kernels.renumber`; Cuthill & McKee 1969). The rows are laid out by colour and length
   (`graphs.order_by_colour, lay_rows`); the last matrix is inverted (`inverse_matrix`). The product behind a backward
   sweep follows from its changes (`graph_sweeps.ascend_graph`; Eisenstat 1981).
4. *Steps* (`conjugate_gradients.converge`, `krylov.advance`). Flexible conjugate gradients (Notay 2000) for the black
   cells of a grid, ``S = D_b - G^T D_r^-1 G``, or all rows of a netlist. Vectors are in single precision; after a
   burst of at most five digits the residual is replaced by the true one, in double precision
   (`krylov.sweep_colour`, `csr_kernels.row_residual`; van der Vorst & Ye 2000), and the search directions go on. It
   ends at ``rtol |b|``, or where rounding, ``eps |A| |x|``, forbids more; from a guess on, also where the steps tell
   that the error is small (`Stop`). On a grid a Gauss-Seidel relaxation does what little is left after the last step.
5. *Cycle* (`cycle.precondition_grid, precondition_graph`). One relaxation before and one after each visit of the next
   level, so that the preconditioner is symmetric; on the coarse levels K-cycles (Notay & Vassilevski 2008): one or two
   steps of conjugate gradients, each preconditioned by the level below. Grids are rows of a table with the addresses of
   their arrays (`levels.GRID`). Subnormal numbers count as zero meanwhile (`resgrid.solvers.llvm_intrinsics`).
6. *Sweeps* (`sweeps`). The time is that of reading conductances from memory. Red cells go ahead of black ones by as far
   as neighbours reach, so that a sweep reads faces once. The product takes conductances in single precision and makes
   up for their rounding on the diagonal (`grid_level.compensated`): rows sum to what leaks. Large levels are cut into
   slabs, which leave the same digits however they are cut; several threads take them, one of which leads in compiled
   code from sweep to sweep (`cycle`, `resgrid.solvers.llvm_intrinsics`).
7. *Refinement* (`resgrid.solvers.refinement`) makes a normwise answer right entry by entry: voltages in double-double,
   with exponents where doubles run out, every pass a solution to many digits of what is largest, until what all rows
   violate KCL by proves that no entry is off by more than 4e-9 of itself and the rounding of the sums. Rows without a
   digit, along slits, are solved directly (`resgrid.solvers.refinement.few_rows`).

References
----------
Notay, Flexible conjugate gradients, SIAM J. Sci. Comput. 22 (2000) 1444.
van der Vorst & Ye, Residual replacement strategies for Krylov subspace methods, SIAM J. Sci. Comput. 22 (2000) 835.
Notay & Vassilevski, Recursive Krylov-based multigrid cycles, Numer. Linear Algebra Appl. 15 (2008) 473.
Notay, An aggregation-based algebraic multigrid method, Electron. Trans. Numer. Anal. 37 (2010) 123.
Cuthill & McKee, Reducing the bandwidth of sparse symmetric matrices, Proc. 24th ACM National Conf. (1969) 157.
Eisenstat, Efficient implementation of a class of preconditioned conjugate gradient methods, SIAM J. Sci. Stat. Comput.
    2 (1981) 1.
O'Cinneide, Entrywise perturbation theory and error analysis for Markov chains, Numer. Math. 65 (1993) 109.
Braess, Towards algebraic multigrid for elliptic problems of second order, Computing 55 (1995) 379.
"""
