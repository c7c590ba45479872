"""Conjugate gradients preconditioned by multigrid: the algorithm on one page (this file contains no code).

`MultigridFactor` solves ``A x = b`` for the Laplacian of a grid or a netlist, in this order:

1. *Red-black grids* (`grid_level.lay_out`, `red_black.Lattice, Stencil`). A grid has two colours, and every edge
   joins a red cell to a black one: ``A = [[D_r, -G], [-G^T, D_b]]``. Conductances are stored face by face over the red
   cells, in flat arrays without indices, in double and in single precision. Cells are numbered with odd strides, so
   that the neighbour across a face lies at the same distance for all red cells. An edge across no face (it closes a
   periodic axis, or leads to an extra node) is an off-stencil coupling. The *slot* of a node is its index in an array
   (slots,) over the nodes of its colour on one level, from 0 for red and for black nodes. The *position* of a node is
   its index in a flattened array (2, slots): the slot of a red node, or the number of slots plus the slot of a black
   node. Position 0 is unused, so that 0 can stand for no node.
2. *Coarse grids* (`grid_coarsening.coarsen`: `count_inside, join_inside, split_blocks, sum_blocks`). A coarse node is
   the connected part of a block of two cells a side, cut where a conductance is weak relative to the strongest at its
   two ends, so that no node joins both sides of a barrier of obstacles. Further parts of a block become extra nodes.
   Axes that conduct badly are coarsened later. The centres of two blocks are joined through half of either block's own
   resistance in series with the conductance between them (plain aggregation underestimates long resistances: Braess
   1995).
3. *Graphs* (`graph_coarsening.grow_aggregates, aggregate_graph`). Netlists from the first level on, and grids that are
   too disconnected, have aggregates grown node by node along the strongest conductances. A netlist whose nodes are
   numbered at random is renumbered first (`ordering_kernels.renumber`; Cuthill & McKee 1969). Rows are stored by colour
   and length (`graph_coarsening.order_by_colour, lay_rows`); the matrix of the coarsest level is inverted
   (`inverse_matrix`). The matrix product after a backward sweep is computed from the changes of the sweep
   (`graph_sweeps.ascend_graph`; Eisenstat 1981).
4. *Iterations* (`conjugate_gradients.converge`, `krylov.advance`). Flexible conjugate gradients (Notay 2000) for the
   black cells of a grid, ``S = D_b - G^T D_r^-1 G``, or all rows of a netlist. Vectors are in single precision. After a
   burst of iterations that gain at most five digits the residual is replaced by the true one, in double precision
   (`krylov.sweep_colour`, `csr_kernels.row_residual`; van der Vorst & Ye 2000), and the search directions are kept. The
   iteration ends at ``rtol |b|``, or at the rounding limit ``eps |A| |x|``; with a guess also when the estimated error
   is small (`StoppingRule`). On a grid a Gauss-Seidel relaxation removes a small remainder after the last iteration.
5. *Cycle* (`cycle.precondition_grid, precondition_graph`). One relaxation before and one after each solution of the
   next level, so that the preconditioner is symmetric. On the coarse levels K-cycles (Notay & Vassilevski 2008): one or
   two steps of conjugate gradients, each preconditioned by the level below. Grids are rows of a table with the
   addresses of their arrays (`levels.GRID`). Subnormal numbers count as zero meanwhile
   (`resgrid.solvers.llvm_intrinsics`).
6. *Sweeps* (`sweeps`). The time is that of reading conductances from memory. In a wavefront sweep red cells are ahead
   of black ones by the distance of neighbours, so that faces are read once. The product takes conductances in single
   precision; the diagonal compensates their rounding (`grid_level.compensated`), so that row sums equal the
   conductances to known voltages. Large levels are divided into slabs, with bitwise equal results for any number of
   slabs. Several threads process them; one leads in compiled code from sweep to sweep (`cycle`,
   `resgrid.solvers.llvm_intrinsics`).
7. *Refinement* (`resgrid.solvers.refinement`) turns a normwise solution into an entrywise accurate one: voltages in
   double-double, with exponents beyond the range of doubles. Every refinement step gains many digits relative to the
   largest entry. Refinement ends when the violations of KCL, summed over all rows, prove a relative error of at most
   4e-9 plus the rounding of the sums for every entry. Rows without correct digits, along narrow slits, are solved
   directly (`resgrid.solvers.refinement.resolve_rows`).

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
