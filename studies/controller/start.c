/* The least that a bare Cortex-M4F needs to run a self-test and say by semihosting how it ended. */
extern unsigned char _stack_top[];
extern int selftest(void);
static void ends(int wrong)
{
    /* SYS_EXIT_EXTENDED: ADP_Stopped_ApplicationExit with the code */
    unsigned int block[2] = {0x20026U, (unsigned int)wrong};
    register unsigned int operation __asm__("r0") = 0x20U;
    register unsigned int *argument __asm__("r1") = block;
    __asm__ volatile("bkpt 0xAB" : : "r"(operation), "r"(argument) : "memory");
    for (;;) { }
}
void reset(void)
{
    *(volatile unsigned int *)0xE000ED88U |= 0xFU << 20; /* switch the FPU on */
    __asm__ volatile("dsb\nisb");
    ends(selftest() != 0);
}
static void fault(void) { ends(255); }
__attribute__((section(".vectors"), used)) static void (*const vectors[16])(void) = {
    (void (*)(void))_stack_top, reset, fault, fault, fault, fault, fault, 0, 0, 0, 0, fault, fault, 0, fault, fault};
